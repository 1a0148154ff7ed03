/* Replies without end through the whole C client, from the frame's first bytes on: what it takes must be sound.
 *
 *     clang -fsanitize=fuzzer,address,undefined fuzz_reply.c glr_request.c glr_reply.c glr_wire.c     guided by coverage
 *     gcc -DPLAIN_DRIVER -fsanitize=address,undefined ...          fuzz_reply SECONDS SEED FILE...: changes without a guide
 *
 * An input is what a server sends over one connection; the request had id 7, as the golden replies do. */
#define MAX_MESSAGE_BYTES (1u << 20) /* else the sanitizer is busy with empty gibibytes */
#include "glr_client.c"

static const uint8_t *come, *come_end;
static double now_s;

double glr_now_s(void) { return now_s += 1e-3; }

glr_outcome glr_connect(glr_socket *handle, const char *host, int port, double deadline_s) {
    (void)host, (void)port, (void)deadline_s;
    *handle = 1 << 30; /* closing it fails, which hurts nobody */
    return GLR_DONE;
}

glr_outcome glr_send_all(glr_socket handle, const void *data, size_t size, double deadline_s) {
    (void)handle, (void)data, (void)size, (void)deadline_s;
    return GLR_DONE;
}

glr_outcome glr_receive_all(glr_socket handle, void *data, size_t size, double deadline_s) {
    (void)handle, (void)deadline_s;
    if (size > (size_t)(come_end - come)) {
        come = come_end;
        return GLR_LOST;
    }
    if (size)
        memcpy(data, come, size);
    come += size;
    return GLR_DONE;
}

static void demand(int is_so, const char *what) {
    if (!is_so) {
        fprintf(stderr, "unsound: %s\n", what);
        abort();
    }
}

/* Every byte is there to be read, and their number is what the sizes say. */
static void check_image(const glr_image *image) {
    static const char *const dtypes[] = {"uint8", "uint16", "int32", "float32", "float64"};
    static const size_t widths[] = {1, 2, 4, 4, 8};
    const volatile uint8_t *pixels = image->pixels;
    size_t k, width = 0;
    for (k = 0; k < 5; k++)
        if (!strcmp(image->dtype, dtypes[k]))
            width = widths[k];
    demand(width && image->height && image->width && image->depth >= 1 && image->depth <= 3, "an image's sizes");
    demand((uintptr_t)pixels % width == 0, "an image's place");
    demand((uint64_t)image->height * image->width * image->depth * width == image->n_bytes, "an image's bytes");
    demand(memchr(image->name, 0, sizeof image->name) != NULL, "an image's name");
    for (k = 0; k < image->n_bytes; k++)
        (void)pixels[k];
}

/* The parser alone, each part in memory of exactly its size: a byte read beyond is found. */
static void parse_parts(const uint8_t *data, size_t size) {
    static glr_reply reply;
    glr_message message;
    glr_error error;
    uint8_t *parts[GLR_MAX_PARTS];
    uint64_t id;
    uint32_t n_parts = size < 8 ? 0 : data[4], k, made;
    size_t at = 8 + 4 * (size_t)n_parts;
    if (n_parts < 1 || n_parts > GLR_MAX_PARTS || at > size)
        return;
    memset(&message, 0, sizeof message);
    memset(&error, 0, sizeof error);
    message.n_parts = n_parts;
    for (made = 0; made < n_parts; made++) {
        uint32_t part = little(data + 8 + 4 * made, 4);
        if (part > size - at) /* cut short: what is there */
            part = (uint32_t)(size - at);
        message.parts[made] = parts[made] = malloc(part ? part : 1);
        demand(parts[made] != NULL, "memory");
        memcpy(parts[made], data + at, part);
        message.sizes[made] = part;
        at += part;
    }
    glr_read_id(&message, &id);
    if (glr_read_render(&message, &reply, &error) == 0)
        for (k = 0; k < reply.n_images; k++)
            check_image(&reply.images[k]);
    for (k = 0; k < made; k++)
        free(parts[k]);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const char *const names[] = {"body"};
    static const glr_pose still = {{0.0, 0.0, 0.0}, {1.0, 0.0, 0.0, 0.0}};
    static const glr_options frames[2];
    static glr_reply reply;
    glr_state state;
    int alone;
    parse_parts(data, size);
    memset(&state, 0, sizeof state);
    state.spacecraft = still;
    state.n_bodies = 1;
    state.body_names = names;
    state.bodies = &still;
    for (alone = 0; alone < 2; alone++) {
        /* A copy of exactly this size: a byte read beyond is found. */
        uint8_t *copy = malloc(size ? size : 1);
        glr_client *client = glr_open("127.0.0.1", 1, 5.0);
        int result;
        uint32_t k;
        demand(copy && client, "memory");
        if (size)
            memcpy(copy, data, size);
        come = copy;
        come_end = copy + size;
        client->next_id = 7;
        memset(&reply, 0xff, sizeof reply);
        if (alone) {
            result = glr_render(client, &state, frames, &reply.images[0]);
            reply.n_images = result == 0;
        } else {
            result = glr_render_frames(client, &state, frames, 2, &reply);
        }
        free(copy);
        demand(result == 0 ? reply.n_images >= 1 && reply.n_images <= GLR_MAX_IMAGES : *glr_error_code(client) != 0,
               "neither images nor an error");
        for (k = 0; result == 0 && k < reply.n_images; k++)
            check_image(&reply.images[k]);
        glr_close(client);
    }
    return 0;
}

#ifdef PLAIN_DRIVER
static uint64_t random_state;

static uint32_t below(uint32_t limit) {
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (uint32_t)(random_state >> 32) % limit;
}

int main(int argc, char **argv) {
    static const uint8_t likely[] = {0, 1, 3, 0x7f, 0x80, 0x90, 0xc1, 0xcf, 0xdb, 0xdd, 0xdf, 0xff};
    static uint8_t data[1 << 16];
    unsigned long long count = 0;
    time_t end = time(NULL) + atoi(argc > 1 ? argv[1] : "1");
    demand(argc > 3, "fuzz_reply SECONDS SEED FILE...");
    random_state = strtoull(argv[2], NULL, 10) * 2 + 1;
    while (time(NULL) < end) {
        FILE *file = fopen(argv[3 + below((uint32_t)argc - 3)], "rb");
        size_t size = 0;
        uint32_t round, k;
        if (file) {
            size = fread(data, 1, sizeof data, file);
            fclose(file);
        }
        demand(size > 0, "a file of the corpus cannot be read");
        for (round = 0; round < 1000; round++, count++) {
            /* Each round spoils what the last one left, for a while: deep changes too. */
            for (k = below(4) + 1; k; k--)
                data[below((uint32_t)size)] = below(2) ? likely[below(sizeof likely)] : (uint8_t)below(256);
            LLVMFuzzerTestOneInput(data, below(8) ? size : below((uint32_t)size + 1));
            if (round % 8 == 7)
                break;
        }
    }
    printf("%llu inputs\n", count);
    return 0;
}
#endif
