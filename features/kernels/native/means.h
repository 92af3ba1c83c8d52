/* Grey levels resized by area, in single precision: the bits of OpenCV's `resize(..., INTER_AREA)`
 * of floats, which adds up along rows, then down. */
#ifndef TOKT_MEANS_H
#define TOKT_MEANS_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "area.h"
#include "instructions.h"

/* A row of a frame in whole grey levels: ITU-R BT.601 in OpenCV's fixed point. */
TOKT_BODY void means_gray(const uint8_t *TOKT_RESTRICT row, const AreaFrame *frame,
                          uint8_t *TOKT_RESTRICT gray) {
    if (frame->channels == 1) {
        memcpy(gray, row, (size_t)frame->width);
        return;
    }
    for (ptrdiff_t x = 0; x < frame->width; x++) {
        int sum = row[3 * x] * 3735 + row[3 * x + 1] * 19235 + row[3 * x + 2] * 9798;
        gray[x] = (uint8_t)((sum + (1 << 14)) >> 15);
    }
}

/* Rows first..last of the means of 2 x 2 pixels of a frame; `scratch` is two rows of bytes. */
TOKT_BODY void means_halved_body(const AreaFrame *frame, int first, int last, uint8_t *scratch,
                                 float *out) {
    ptrdiff_t width = frame->width / 2;
    uint8_t *TOKT_RESTRICT one = scratch, *TOKT_RESTRICT two = scratch + frame->width;
    for (int y = first; y < last; y++) {
        float *TOKT_RESTRICT mean = out + y * width;
        means_gray(frame->pixels + 2 * y * frame->stride, frame, one);
        means_gray(frame->pixels + (2 * y + 1) * frame->stride, frame, two);
        for (ptrdiff_t x = 0; x < width; x++)
            mean[x] = (float)(one[2 * x] + one[2 * x + 1] + two[2 * x] + two[2 * x + 1]) * 0.25f;
    }
}

TOKT_VARIANTS(means_halved,
              (const AreaFrame *frame, int first, int last, uint8_t *scratch, float *out),
              (frame, first, last, scratch, out))

/* The rows (or columns) of a view that make one of another: three from `source`, and weights. */
typedef struct {
    const int32_t *source;
    const float *weight;
} MeansTaps;

/* Rows first..last of a view `stride` pixels wide, resized; `along` is one of its rows. */
TOKT_BODY void means_rows_body(const float *view, ptrdiff_t stride, const MeansTaps *rows,
                               const MeansTaps *columns, int first, int last, ptrdiff_t width,
                               float *TOKT_RESTRICT along, float *out) {
    for (int i = 3 * first, made = -1; i < 3 * last; i++) {
        float *TOKT_RESTRICT mean = out + i / 3 * width;
        const float *TOKT_RESTRICT weight = columns->weight;
        int row = rows->source[i / 3] + i % 3;
        float part = rows->weight[i];
        if (i % 3 == 0) memset(mean, 0, (size_t)width * sizeof *mean);
        if (part == 0) continue;
        if (row != made) /* which one on the border of two pixels is a part of both */
            for (ptrdiff_t x = 0; x < width; x++, weight += 3) {
                const float *in = view + row * stride + columns->source[x];
                along[x] = in[0] * weight[0] + in[1] * weight[1] + in[2] * weight[2];
            }
        made = row;
        for (ptrdiff_t x = 0; x < width; x++) mean[x] += part * along[x];
    }
}

TOKT_VARIANTS_TO_AVX2(means_rows,
                      (const float *view, ptrdiff_t stride, const MeansTaps *rows,
                       const MeansTaps *columns, int first, int last, ptrdiff_t width,
                       float *along, float *out),
                      (view, stride, rows, columns, first, last, width, along, out))

#endif
