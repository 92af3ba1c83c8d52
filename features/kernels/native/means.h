/* Grey levels resized by area, in single precision: the bits of OpenCV's `resize(..., INTER_AREA)`
 * of floats, which adds up along rows, then down. */
#ifndef TOKT_MEANS_H
#define TOKT_MEANS_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "area.h"
#include "instructions.h"

enum { MEANS_TAPS = 3 /* weights that a pixel mostly has */ };

/* A row of a frame in whole grey levels: ITU-R BT.601 in OpenCV's fixed point. */
TOKT_BODY void means_gray(const uint8_t *TOKT_RESTRICT row, int channels, ptrdiff_t width,
                          uint8_t *TOKT_RESTRICT gray) {
    if (channels == 1) {
        memcpy(gray, row, (size_t)width);
        return;
    }
    for (ptrdiff_t x = 0; x < width; x++) {
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
        const uint8_t *row = frame->pixels + 2 * y * frame->stride;
        float *TOKT_RESTRICT mean = out + y * width;
        means_gray(row, frame->channels, frame->width, one);
        means_gray(row + frame->stride, frame->channels, frame->width, two);
        for (ptrdiff_t x = 0; x < width; x++)
            mean[x] = (float)(one[2 * x] + one[2 * x + 1] + two[2 * x] + two[2 * x + 1]) * 0.25f;
    }
}

TOKT_VARIANTS(means_halved,
              (const AreaFrame *frame, int first, int last, uint8_t *scratch, float *out),
              (frame, first, last, scratch, out))

/* Add up what of a row makes each of `width` pixels; all of them have as many weights. */
TOKT_BODY void means_along(const float *TOKT_RESTRICT row, const AreaTable *columns, int width,
                           float *TOKT_RESTRICT along) {
    const int32_t *TOKT_RESTRICT source = columns->source;
    const float *TOKT_RESTRICT weight = columns->weight;
    int taps = columns->first[1];
    if (taps == MEANS_TAPS) {
        for (ptrdiff_t x = 0; x < width; x++, weight += MEANS_TAPS) {
            const float *in = row + source[x];
            along[x] = in[0] * weight[0] + in[1] * weight[1] + in[2] * weight[2];
        }
        return;
    }
    for (ptrdiff_t x = 0; x < width; x++) {
        float sum = 0;
        for (int i = 0; i < taps; i++) sum += row[source[x] + i] * weight[taps * x + i];
        along[x] = sum;
    }
}

/* Rows first..last of a view `stride` pixels wide, resized; `along` is one of its rows. */
TOKT_BODY void means_rows_body(const float *view, int stride, const AreaTable *rows,
                               const AreaTable *columns, int first, int last, int width,
                               float *TOKT_RESTRICT along, float *out) {
    for (int y = first, made = -1; y < last; y++) {
        float *TOKT_RESTRICT mean = out + (ptrdiff_t)y * width;
        for (ptrdiff_t x = 0; x < width; x++) mean[x] = 0;
        for (int i = rows->first[y]; i < rows->first[y + 1]; i++) {
            int row = rows->source[y] + i - rows->first[y];
            float weight = rows->weight[i];
            /* A row on the border of two pixels is a part of both. */
            if (row != made) means_along(view + (ptrdiff_t)row * stride, columns, width, along);
            made = row;
            for (ptrdiff_t x = 0; x < width; x++) mean[x] += weight * along[x];
        }
    }
}

TOKT_VARIANTS_TO_AVX2(means_rows,
                      (const float *view, int stride, const AreaTable *rows,
                       const AreaTable *columns, int first, int last, int width, float *along,
                       float *out),
                      (view, stride, rows, columns, first, last, width, along, out))

#endif
