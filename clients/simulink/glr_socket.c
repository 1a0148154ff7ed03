#ifndef _WIN32
#define _POSIX_C_SOURCE 200809L
#endif
#include "glr_socket.h"

#include <stdio.h>
#include <string.h>

double glr_now_s(void) {
#ifdef _WIN32
    return 1e-3 * (double)GetTickCount64();
#else
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
#endif
}

static int would_block(void) {
#ifdef _WIN32
    return WSAGetLastError() == WSAEWOULDBLOCK;
#else
    return errno == EAGAIN || errno == EWOULDBLOCK || errno == EINPROGRESS || errno == EINTR;
#endif
}

static void set_nonblocking(glr_socket handle) {
#ifdef _WIN32
    u_long yes = 1;
    ioctlsocket(handle, FIONBIO, &yes);
#else
    fcntl(handle, F_SETFL, fcntl(handle, F_GETFL, 0) | O_NONBLOCK);
#endif
}

static glr_outcome wait_for(glr_socket handle, short events, double deadline_s) {
    for (;;) {
        double left_s = deadline_s - glr_now_s();
        struct pollfd item;
        int found;
        if (!(left_s > 0.0))
            return GLR_LATE;
        item.fd = handle;
        item.events = events;
        item.revents = 0;
        found = glr_poll(&item, 1, left_s > 1e6 ? 1000000000 : (int)(1e3 * left_s) + 1);
        if (found > 0)
            return GLR_DONE;
        if (found < 0 && !would_block())
            return GLR_LOST;
    }
}

glr_outcome glr_connect(glr_socket *handle, const char *host, int port, double deadline_s) {
    struct addrinfo hints, *found = NULL, *entry;
    char service[16];
    glr_outcome outcome = GLR_LOST;
#ifdef _WIN32
    WSADATA data;
    if (WSAStartup(MAKEWORD(2, 2), &data))
        return GLR_LOST;
#endif
    memset(&hints, 0, sizeof hints);
    hints.ai_family = AF_UNSPEC;
    hints.ai_socktype = SOCK_STREAM;
    snprintf(service, sizeof service, "%d", port);
    *handle = GLR_NO_SOCKET;
    if (getaddrinfo(host, service, &hints, &found))
        return GLR_LOST;
    for (entry = found; entry && outcome != GLR_DONE; entry = entry->ai_next) {
        int error = 0, yes = 1;
        socklen_t size = sizeof error;
        glr_socket tried = socket(entry->ai_family, entry->ai_socktype, entry->ai_protocol);
        if (tried == GLR_NO_SOCKET)
            continue;
        set_nonblocking(tried);
        setsockopt(tried, IPPROTO_TCP, TCP_NODELAY, (const char *)&yes, sizeof yes);
        outcome = GLR_DONE;
        if (connect(tried, entry->ai_addr, (socklen_t)entry->ai_addrlen))
            outcome = would_block() ? wait_for(tried, POLLOUT, deadline_s) : GLR_LOST;
        if (outcome == GLR_DONE && (getsockopt(tried, SOL_SOCKET, SO_ERROR, (char *)&error, &size) || error))
            outcome = GLR_LOST;
        if (outcome == GLR_DONE)
            *handle = tried;
        else
            glr_close_socket(tried);
    }
    freeaddrinfo(found);
    return outcome;
}

glr_outcome glr_send_all(glr_socket handle, const void *data, size_t size, double deadline_s) {
    const char *at = data;
    while (size) {
        int step = (int)send(handle, at, size > 1 << 30 ? 1 << 30 : size, GLR_SEND_FLAGS);
        if (step > 0) {
            at += step;
            size -= (size_t)step;
        } else if (would_block()) {
            glr_outcome outcome = wait_for(handle, POLLOUT, deadline_s);
            if (outcome != GLR_DONE)
                return outcome;
        } else {
            return GLR_LOST;
        }
    }
    return GLR_DONE;
}

glr_outcome glr_receive_all(glr_socket handle, void *data, size_t size, double deadline_s) {
    char *at = data;
    while (size) {
        int step = (int)recv(handle, at, size > 1 << 30 ? 1 << 30 : size, 0);
        if (step > 0) {
            at += step;
            size -= (size_t)step;
        } else if (step < 0 && would_block()) {
            glr_outcome outcome = wait_for(handle, POLLIN, deadline_s);
            if (outcome != GLR_DONE)
                return outcome;
        } else {
            return GLR_LOST;
        }
    }
    return GLR_DONE;
}
