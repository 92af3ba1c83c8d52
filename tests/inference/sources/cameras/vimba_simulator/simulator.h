/* What the files of the simulated Vimba share: one rig of up to four cameras, under one lock. */
#ifndef SIMULATOR_H
#define SIMULATOR_H

#include <pthread.h>

#include "vimba_types.h"

enum { MAX_CAMERAS = 4, MAX_FEATURES = 40, MAX_FRAMES = 64 };
enum { SYSTEM_HANDLE = 1, FIRST_CAMERA_HANDLE = 100 };

typedef struct {
    const char *name;
    int kind;
    double number;              /* of an int, a float or a bool */
    double least, most;         /* of an int or a float */
    char text[32];              /* of an enum: the entry that is chosen */
    const char *entries;        /* of an enum: all of them, as ",One,Two," */
} Feature;

typedef struct {
    VmbFrame *frame;
    VmbFrameCallback callback;
} Queued;

typedef struct {
    /* What a test sets; see control.c. */
    double delay_s, jitter_s, clock_offset_s, phase;
    double unplug_at_s, replug_at_s; /* since VmbStartup; negative: never */
    int drop_every, incomplete_every, again;
    bool plugged, mute, unnoticed, handle_dies, usb;
    bool hangs_at_open, hangs_at_close, hangs_at_exit;

    /* What the API knows. */
    bool known, opened, power_cycled;
    int features;
    Feature feature[MAX_FEATURES];

    /* Its stream; see stream.c. */
    bool acquiring, capturing, ending;
    pthread_t thread;
    uint64_t frame_id, newest_moment, newest_id;
    VmbFrame *announced[MAX_FRAMES];
    int announced_count;
    Queued queue[MAX_FRAMES];
    int queued;

    /* What happened, for tests. */
    long delivered, starved, starts;
} Camera;

typedef struct {
    pthread_mutex_t lock;
    pthread_cond_t changed;
    bool started;
    double start_s;   /* CLOCK_MONOTONIC */
    double rate_hz;   /* one trigger for all cameras */
    int width, height;
    int cameras;
    long startups;
    Feature system_feature[MAX_FEATURES];
    int system_features;
    Camera camera[MAX_CAMERAS];
} Rig;

extern Rig rig;

double now_s(void);
void hang_while(bool *hangs);                /* until a test says otherwise; locked */
void apply_plan(void);                       /* unplug and replug at their times; locked */
Camera *camera_of(VmbHandle handle, VmbError *error);  /* an opened one that answers; locked */
Camera *handle_of(VmbHandle handle);         /* an opened one, plugged or not; locked */

void describe_system(void);                  /* features.c: what the system has */
void power_up(Camera *camera);               /* features.c: as they are after switching on */
Feature *feature_named(Feature *features, int count, const char *name);
uint32_t pixel_format_number(const char *name);
int bytes_per_pixel(const char *name);

VmbError start_acquisition(Camera *camera);
VmbError stop_acquisition(Camera *camera);

void draw(uint8_t *buffer, uint32_t size, int camera, uint64_t moment); /* pattern.c */

#endif
