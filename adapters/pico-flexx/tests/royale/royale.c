/* A stand-in for libroyaleCAPI, built by the test beside it: the functions of Royale 3 that the adapter uses, with a camera of
 * 224 x 172 points whose callback runs on a thread of its own, as the library's does.
 *
 * What it does is told by the text file `<library>.control`, read again for every frame; what happened stands in
 * `<library>.report`. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <math.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#define WIDTH 224
#define HEIGHT 172

typedef struct { float x, y, z, noise; uint16_t gray_value; uint8_t depth_confidence; } depth_point;
typedef struct {
    int version;
    long long timestamp;
    uint16_t stream_id, width, height;
    uint32_t *exposure_times;
    uint32_t nr_exposure_times;
    depth_point *points;
    uint32_t nr_points;
} depth_data;
typedef struct { float first, second; } pair;
typedef struct { pair principal_point, focal_length, tangential; struct { float *values; uint32_t n; } radial; } lens;
typedef void listener(depth_data *);

static const char *cases[] = {"MODE_9_10FPS_1000", "MODE_5_45FPS_500", "MODE_MIXED_30_5"};
static int managers, cameras, strings, starts, stops, exposure_mode = -1;
static uint32_t exposure_us;
static uint16_t rate;
static bool initialized, capturing;
static char current[64];
static listener *heard;
static pthread_t thread;

static void path_of(const char *ending, char *path, size_t size) {
    Dl_info info;
    dladdr((void *)path_of, &info);
    snprintf(path, size, "%s.%s", info.dli_fname, ending);
}

static long told(const char *word, long otherwise) {
    char path[4096], line[256];
    path_of("control", path, sizeof path);
    FILE *file = fopen(path, "r");
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
    path_of("report", path, sizeof path);
    FILE *file = fopen(path, "w");
    if (!file) return;
    fprintf(file, "managers=%d cameras=%d strings=%d starts=%d stops=%d listens=%d case=%s exposure=%d/%u rate=%u\n",
            managers, cameras, strings, starts, stops, heard != NULL, current, exposure_mode, exposure_us, rate);
    fclose(file);
}

void royale_get_version_v220(unsigned *major, unsigned *minor, unsigned *patch) {
    *major = (unsigned)told("major", 3);
    *minor = 10;
    *patch = 1;
}

uint64_t royale_camera_manager_create(void) {
    managers++;
    return told("no_manager", 0) ? (managers--, 0) : 77;
}

void royale_camera_manager_destroy(uint64_t m) {
    (void)m;
    managers--;
}

static char **list_of(const char **texts, uint32_t n) {
    char **list = malloc(sizeof(char *) * (n ? n : 1));
    for (uint32_t i = 0; i < n; i++) list[i] = strdup(texts[i]);
    strings++;
    return list;
}

char **royale_camera_manager_get_connected_cameras(uint64_t m, uint32_t *n) {
    static const char *ids[] = {"0005-1203-0034-2210", "0005-1203-0034-2211"};
    (void)m;
    *n = (uint32_t)told("cameras", 1);
    return *n ? list_of(ids, *n) : NULL;
}

void royale_free_string_array(char **list, uint32_t n) {
    for (uint32_t i = 0; i < n; i++) free(list[i]);
    free(list);
    strings--;
}

void royale_free_string(char *text) {
    free(text);
    strings--;
}

uint64_t royale_camera_manager_create_camera(uint64_t m, const char *id) {
    (void)m;
    if (cameras || strncmp(id, "0005-1203-0034-221", 18)) return 0;
    cameras++;
    return 4711;
}

int royale_camera_device_initialize_v210(uint64_t h) {
    initialized = h == 4711;
    return (int)told("initialize", 0);
}

void royale_camera_device_destroy_v210(uint64_t h) {
    if (h == 4711) cameras--;
    report();
}

int royale_camera_device_get_use_cases_v220(uint64_t h, char ***list, uint32_t *n) {
    if (h != 4711 || !initialized) return 5004;
    *list = list_of(cases, *n = 3);
    return 0;
}

int royale_camera_device_set_use_case_v210(uint64_t h, const char *name) {
    for (int i = 0; i < 3; i++)
        if (h == 4711 && !strcmp(name, cases[i])) {
            snprintf(current, sizeof current, "%s", name);
            return 0;
        }
    return 5001;
}

int royale_camera_device_get_current_use_case_v220(uint64_t h, char **name) {
    (void)h;
    *name = strdup(told("other_case", 0) ? cases[1] : current);
    strings++;
    return 0;
}

int royale_camera_device_set_exposure_mode_v300(uint64_t h, uint16_t stream, int mode) {
    if (h != 4711 || stream != 0) return 2048;
    exposure_mode = mode;
    return 0;
}

int royale_camera_device_set_exposure_time_v300(uint64_t h, uint16_t stream, uint32_t us) {
    if (h != 4711 || stream != 0 || exposure_mode != 0) return 2048;
    exposure_us = us;
    return 0;
}

int royale_camera_device_get_exposure_limits_v300(uint64_t h, uint16_t stream, uint32_t *least, uint32_t *most) {
    (void)h, (void)stream;
    *least = 80;
    *most = 1000;
    return 0;
}

int royale_camera_device_get_max_sensor_width_v220(uint64_t h, uint16_t *w) { (void)h; *w = (uint16_t)told("width", WIDTH); return 0; }
int royale_camera_device_get_max_sensor_height_v220(uint64_t h, uint16_t *w) { (void)h; *w = HEIGHT; return 0; }

int royale_camera_device_get_lens_parameters_v210(uint64_t h, lens *l) {
    static float radial[3] = {0.4f, -2.5f, 3.5f};
    (void)h;
    *l = (lens){{112.5f, 86.25f}, {212.5f, 212.75f}, {0.001f, -0.002f}, {radial, (uint32_t)told("radial", 3)}};
    return 0;
}

int royale_camera_device_register_data_listener_v210(uint64_t h, listener *callback) {
    (void)h;
    heard = callback;
    return 0;
}

int royale_camera_device_unregister_data_listener_v210(uint64_t h) {
    (void)h;
    heard = NULL;
    return 0;
}

static void *frames(void *nothing) {
    static uint64_t frame;
    depth_point *points = calloc(WIDTH * HEIGHT, sizeof *points);
    while (capturing) {
        usleep(20000);
        if (told("silent", 0) || told("unplugged", 0)) continue;
        frame += 1 + (uint64_t)told("skip", 0);
        for (int i = 0; i < WIDTH * HEIGHT; i++)
            points[i] = (depth_point){0.1f, 0.2f, 1.0f + 0.001f * (frame % 100), 0.01f, 300, 255};
        points[0].depth_confidence = 0;
        points[1].noise = 0.5f;
        points[2].z = NAN;
        points[3].depth_confidence = 3;
        uint32_t exposure[2] = {640, 20};
        depth_data data = {1, 1700000000000000LL + (long long)frame * 22222, (uint16_t)told("stream", 9), WIDTH, HEIGHT,
                           exposure, 2, points, WIDTH * HEIGHT};
        if (told("short", 0)) data.nr_points /= 2;
        if (told("null", 0)) data.points = NULL;
        listener *callback = heard;
        if (callback) callback(&data);
        if (callback && told("streams", 0)) {
            /* A second stream between: farther away. */
            for (int i = 0; i < WIDTH * HEIGHT; i++) points[i].z = 3.0f;
            data.stream_id = 10;
            callback(&data);
        }
    }
    free(points);
    return nothing;
}

int royale_camera_device_start_capture_v210(uint64_t h) {
    if (h != 4711 || told("start", 0)) return (int)told("start", 5004);
    capturing = true;
    starts++;
    report();
    return pthread_create(&thread, NULL, frames, NULL);
}

int royale_camera_device_stop_capture_v210(uint64_t h) {
    (void)h;
    capturing = false;
    stops++;
    return pthread_join(thread, NULL);
}

int royale_camera_device_is_connected_v220(uint64_t h, bool *connected) {
    (void)h;
    *connected = !told("unplugged", 0);
    return 0;
}

int royale_camera_device_set_frame_rate_v210(uint64_t h, uint16_t hz) { (void)h; rate = hz; return 0; }
int royale_camera_device_get_max_frame_rate_v220(uint64_t h, uint16_t *hz) { (void)h; *hz = 45; return 0; }
