/* Blocking TCP with a deadline, on POSIX and Winsock. Private to glr_client.c. */
#ifndef GLR_SOCKET_H
#define GLR_SOCKET_H

#ifdef _WIN32
#include <winsock2.h>
#include <ws2tcpip.h>
typedef SOCKET glr_socket;
#define GLR_NO_SOCKET INVALID_SOCKET
#define glr_close_socket closesocket
#define glr_poll WSAPoll
#define GLR_SEND_FLAGS 0
#else
#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/types.h>
#include <time.h>
#include <unistd.h>
typedef int glr_socket;
#define GLR_NO_SOCKET (-1)
#define glr_close_socket close
#define glr_poll poll
#ifdef MSG_NOSIGNAL
#define GLR_SEND_FLAGS MSG_NOSIGNAL /* a server that is gone must not kill the simulation */
#else
#define GLR_SEND_FLAGS 0
#endif
#endif

#include <stddef.h>

typedef enum { GLR_DONE = 0, GLR_LATE, GLR_LOST } glr_outcome;

/* Seconds of a clock that never jumps. */
double glr_now_s(void);
glr_outcome glr_connect(glr_socket *handle, const char *host, int port, double deadline_s);
glr_outcome glr_send_all(glr_socket handle, const void *data, size_t size, double deadline_s);
glr_outcome glr_receive_all(glr_socket handle, void *data, size_t size, double deadline_s);

#endif
