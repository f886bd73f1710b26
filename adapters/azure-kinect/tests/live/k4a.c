/* A stand-in for libk4a, built by the test beside it: the functions of version 1.4 that the adapter uses, without a device.
 *
 * What it does is told by the text file `<library>.control`, read at every call; the calibration is `<library>.json`.
 * What happened stands in `<library>.report`: how many captures and images are still alive, and what was called. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

typedef struct {
    int32_t color_format, color_resolution, depth_mode, camera_fps;
    bool synchronized_images_only;
    int32_t depth_delay_off_color_usec, wired_sync_mode;
    uint32_t subordinate_delay_off_master_usec;
    bool disable_streaming_indicator;
} configuration;

typedef struct { int refs, format, width, height, stride; size_t size; uint8_t *buffer; uint64_t device_us; } image;
typedef struct { int refs; image *depth; } capture;
typedef struct { uint32_t index; bool streams; int width, height, period_us; uint64_t frame; } device;

typedef void log_callback(void *, int, const char *, int, const char *);
static log_callback *logger;
static void *logger_context;
static int captures, images, opens, starts, stops, closes, opened[4];
static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;

static const char *beside(const char *ending, char *path, size_t size) {
    Dl_info info;
    dladdr((void *)beside, &info);
    snprintf(path, size, "%s.%s", info.dli_fname, ending);
    return path;
}

/* The number behind a word of the control file, or another one. */
static long told(const char *word, long otherwise) {
    char path[4096], line[256];
    FILE *file = fopen(beside("control", path, sizeof path), "r");
    if (!file) return otherwise;
    while (fgets(line, sizeof line, file)) {
        size_t n = strlen(word);
        if (!strncmp(line, word, n) && line[n] == '=') otherwise = strtol(line + n + 1, NULL, 0);
    }
    fclose(file);
    return otherwise;
}

static void report(void) {
    char path[4096];
    FILE *file = fopen(beside("report", path, sizeof path), "w");
    if (!file) return;
    fprintf(file, "captures=%d images=%d opens=%d closes=%d starts=%d stops=%d\n", captures, images, opens, closes,
            starts, stops);
    fclose(file);
}

static void say(const char *message) {
    if (logger) logger(logger_context, 1, "k4a.c", 1, message);
}

uint32_t k4a_device_get_installed_count(void) { return (uint32_t)told("devices", 1); }

int k4a_set_debug_message_handler(log_callback *callback, void *context, int level) {
    (void)level;
    logger = callback;
    logger_context = context;
    return 0;
}

int k4a_device_open(uint32_t index, device **out) {
    *out = NULL;
    if (index >= 4 || index >= (uint32_t)told("devices", 1) || opened[index] || told("refuse_open", 0)) {
        say("libusb device is busy");
        return 1;
    }
    *out = calloc(1, sizeof(device));
    (*out)->index = index;
    opened[index] = 1;
    opens++;
    report();
    return 0;
}

void k4a_device_stop_cameras(device *d) {
    d->streams = false;
    stops++;
}

void k4a_device_close(device *d) {
    opened[d->index] = 0;
    closes++;
    report();
    free(d);
}

int k4a_device_get_serialnum(device *d, char *text, size_t *size) {
    char serial[16];
    snprintf(serial, sizeof serial, "00000%u", d->index + 1);
    size_t need = strlen(serial) + 1;
    if (!text || *size < need) {
        *size = need;
        return 2;
    }
    *size = need;
    memcpy(text, serial, need);
    return 0;
}

int k4a_device_get_raw_calibration(device *d, uint8_t *text, size_t *size) {
    (void)d;
    char path[4096];
    FILE *file = fopen(beside("json", path, sizeof path), "r");
    if (!file) return 1;
    fseek(file, 0, SEEK_END);
    size_t need = (size_t)ftell(file) + 1;
    rewind(file);
    int answer = 2;
    if (text && *size >= need) {
        answer = fread(text, 1, need - 1, file) == need - 1 ? 0 : 1;
        text[need - 1] = 0;
    }
    *size = need;
    fclose(file);
    return answer;
}

int k4a_device_start_cameras(device *d, const configuration *c) {
    static const int sizes[5][2] = {{0, 0}, {320, 288}, {640, 576}, {512, 512}, {1024, 1024}};
    static const int periods[3] = {200000, 66667, 33333};
    if (c->color_format != 0 || c->color_resolution != 0 || c->depth_mode < 1 || c->depth_mode > 4 ||
        c->camera_fps < 0 || c->camera_fps > 2 || c->synchronized_images_only || c->depth_delay_off_color_usec ||
        c->wired_sync_mode || c->subordinate_delay_off_master_usec ||
        c->disable_streaming_indicator != (told("dark", 0) != 0)) {
        say("unexpected configuration");
        return 1;
    }
    if (told("refuse_start", 0)) {
        say("Depth engine create and initialize failed with error code: 204");
        return 1;
    }
    d->width = sizes[c->depth_mode][0];
    d->height = sizes[c->depth_mode][1];
    d->period_us = periods[c->camera_fps];
    d->streams = true;
    starts++;
    report();
    return 0;
}

int k4a_image_create(int format, int width, int height, int stride, image **out) {
    image *made = calloc(1, sizeof(image));
    *made = (image){1, format, width, height, stride, (size_t)stride * height, NULL, 0};
    made->buffer = calloc(1, made->size ? made->size : 1);
    pthread_mutex_lock(&mutex);
    images++;
    pthread_mutex_unlock(&mutex);
    *out = made;
    return 0;
}

void k4a_image_release(image *i) {
    pthread_mutex_lock(&mutex);
    if (!--i->refs) {
        images--;
        free(i->buffer);
        free(i);
    }
    pthread_mutex_unlock(&mutex);
}

int k4a_capture_create(capture **out) {
    *out = calloc(1, sizeof(capture));
    (*out)->refs = 1;
    captures++;
    return 0;
}

void k4a_capture_set_depth_image(capture *c, image *i) {
    i->refs++;
    c->depth = i;
}

void k4a_capture_release(capture *c) {
    if (--c->refs) return;
    if (c->depth) k4a_image_release(c->depth);
    captures--;
    free(c);
    report();
}

int k4a_device_get_capture(device *d, capture **out, int32_t timeout_ms) {
    *out = NULL;
    if (!d->streams || told("lost", 0)) {
        say("USB device was disconnected");
        return 1;
    }
    if (told("silent", 0)) {
        usleep((useconds_t)timeout_ms * 1000);
        return 2;
    }
    usleep((useconds_t)d->period_us);
    d->frame += 1 + (uint64_t)told("skip", 0);
    capture *c;
    k4a_capture_create(&c);
    if (!told("without_depth", 0)) {
        int odd = told("padded", 0) ? 64 : 0;
        image *i;
        k4a_image_create((int)told("format", 4), d->width, d->height, d->width * 2 + odd, &i);
        i->device_us = 1000000 + d->frame * (uint64_t)d->period_us;
        for (int row = 0; row < d->height; row++)
            for (int column = 0; column < d->width; column++)
                ((uint16_t *)(i->buffer + (size_t)row * i->stride))[column] =
                    (uint16_t)(column == 0 ? 0 : 500 + row + (d->frame & 0xff));
        if (told("short", 0)) i->size = i->size / 2;
        k4a_capture_set_depth_image(c, i);
        k4a_image_release(i);
    }
    *out = c;
    return 0;
}

image *k4a_capture_get_depth_image(capture *c) {
    if (c->depth) c->depth->refs++;
    return c->depth;
}

float k4a_capture_get_temperature_c(capture *c) { (void)c; return 31.5f; }
uint8_t *k4a_image_get_buffer(image *i) { return i->buffer; }
size_t k4a_image_get_size(image *i) { return i->size; }
int k4a_image_get_format(image *i) { return i->format; }
int k4a_image_get_width_pixels(image *i) { return i->width; }
int k4a_image_get_height_pixels(image *i) { return i->height; }
int k4a_image_get_stride_bytes(image *i) { return i->stride; }
uint64_t k4a_image_get_device_timestamp_usec(image *i) { return i->device_us; }
void k4a_image_set_device_timestamp_usec(image *i, uint64_t us) { i->device_us = us; }
