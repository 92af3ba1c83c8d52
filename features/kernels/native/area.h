/* Area resize of a BGR or gray frame, and its gray picture, in one pass over the frame.
 *
 * The pixels are those of OpenCV's `resize(..., INTER_AREA)` followed by `cvtColor(...,
 * COLOR_BGR2GRAY)`: each step rounded to whole grey levels. OpenCV sums along the row first, in
 * single precision; here whole rows are added first, which a processor does many pixels at a
 * time. The two orders differ by rounding alone, so only a value that lies very near the middle
 * between two grey levels can come out differently. How near depends on how many terms a sum has
 * (`near_tie`, from the caller); those few are summed again in OpenCV's order. */
#ifndef TOKT_AREA_H
#define TOKT_AREA_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "instructions.h"

enum {
    AREA_LANES = 4, /* values a pixel of a row that was summed along: B, G, R and one unused */
    AREA_CACHE_LINE = 64, /* bytes */
    AREA_CHUNK = 64 /* values that are looked through together for near ties */
};

typedef struct {
    const uint8_t *pixels;
    ptrdiff_t stride; /* bytes from row to row */
    int width, channels;
} AreaFrame;

/* Floats that a row of a picture needs as scratch; the frame's row is read one value beyond. */
static size_t area_scratch(const AreaFrame *frame, int width) {
    return (size_t)frame->width * frame->channels + AREA_LANES + 2 * AREA_LANES * (size_t)width;
}

#define SUMS_NAME(name) area_##name
#define SUMS_TABLE AreaTable
#define SUMS_VALUE float
#define SUMS_LANE float
#include "area_sums.h"

/* One value as OpenCV sums it, rounded. */
static int area_exact(const AreaFrame *frame, const AreaTable *rows, const AreaTable *columns,
                      int y, int x, int channel) {
    const uint8_t *in = frame->pixels + rows->source[y] * frame->stride +
                        (ptrdiff_t)columns->source[x] * frame->channels + channel;
    const float *across = columns->weight + columns->first[x];
    int count = columns->first[x + 1] - columns->first[x];
    float sum = 0;
    for (int row = rows->first[y]; row < rows->first[y + 1]; row++, in += frame->stride) {
        float along = 0;
        for (int i = 0; i < count; i++) along += (float)in[i * frame->channels] * across[i];
        sum += rows->weight[row] * along;
    }
    return (int)lrintf(sum);
}

/* Sums as whole grey levels; returns how many lie too near the middle of two to tell. */
TOKT_BODY int area_round(const float *TOKT_RESTRICT sums, int n, float near_tie,
                         int32_t *TOKT_RESTRICT levels) {
    int near = 0;
    for (int i = 0; i < n; i++) {
        int32_t level = (int32_t)(sums[i] + 0.5f);
        near += fabsf(sums[i] - (float)level) > 0.5f - near_tie;
        levels[i] = level;
    }
    return near;
}

/* Decide the values first..last that `area_round` could not. */
static void area_settle(const AreaFrame *frame, const AreaTable *rows, const AreaTable *columns,
                        int y, int first, int last, float near_tie, const float *sums,
                        int32_t *levels) {
    int lanes = frame->channels == 1 ? 1 : AREA_LANES;
    for (int i = first; i < last; i++)
        if (fabsf(sums[i] - (float)levels[i]) > 0.5f - near_tie && i % lanes < frame->channels)
            levels[i] = area_exact(frame, rows, columns, y, i / lanes, i % lanes);
}

/* Rows first..last of the gray picture. */
TOKT_BODY void area_gray_rows_body(const AreaFrame *frame, const AreaTable *rows,
                                   const AreaTable *columns, int first, int last, int width,
                                   float near_tie, float *scratch, uint8_t *out) {
    int lanes = frame->channels == 1 ? 1 : AREA_LANES;
    float *sums = scratch, *along = sums + (size_t)frame->width * frame->channels + AREA_LANES;
    int32_t *levels = (int32_t *)(along + (size_t)AREA_LANES * width);
    /* What follows a row is read as the fourth value of its last pixel. */
    for (int lane = 0; lane < AREA_LANES; lane++) along[lane - AREA_LANES] = 0;
    for (int y = first; y < last; y++) {
        uint8_t *TOKT_RESTRICT gray = out + (ptrdiff_t)y * width;
        area_add_rows(frame, rows, y, sums);
        int next = y + 1 < last ? y + 1 : y;
        area_add_columns(frame, rows, next, columns, width, sums, along);
        for (int i = 0; i < lanes * width; i += AREA_CHUNK) {
            int n = lanes * width - i < AREA_CHUNK ? lanes * width - i : AREA_CHUNK;
            if (area_round(along + i, n, near_tie, levels + i))
                area_settle(frame, rows, columns, y, i, i + n, near_tie, along, levels);
        }
        if (lanes == 1) {
            for (int x = 0; x < width; x++) gray[x] = (uint8_t)levels[x];
            continue;
        }
        /* ITU-R BT.601 in OpenCV's fixed point. */
        for (int x = 0; x < width; x++) {
            const int32_t *pixel = levels + AREA_LANES * x;
            gray[x] = (uint8_t)((pixel[0] * 3735 + pixel[1] * 19235 + pixel[2] * 9798 + (1 << 14)) >> 15);
        }
    }
}

TOKT_VARIANTS(area_gray_rows,
              (const AreaFrame *frame, const AreaTable *rows, const AreaTable *columns, int first,
               int last, int width, float near_tie, float *scratch, uint8_t *out),
              (frame, rows, columns, first, last, width, near_tie, scratch, out))

#endif
