/* How much a picture's pixels differ from those some pixels away: noise at once, what is to be
 * seen more and more. */
#ifndef TOKT_DETAIL_H
#define TOKT_DETAIL_H

#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "area.h"
#include "instructions.h"
#include "quantization.h"

enum {
    DETAIL_BRIGHT = 250,  /* grey levels */
    DETAIL_MOST = 16 * 256, /* a second difference counts as that much at most: 2^24 squared */
    CURVATURE_ROWS = 64 /* of which two squares a pixel fit 32 bits */
};

/* What is compared: bytes of some rows of a frame with those `lags` pixels on, and rows below. */
typedef struct {
    const AreaFrame *frame;
    const int64_t *rows;
    int cols, count;
    const int32_t *lags;
} DetailRows;

TOKT_BODY int detail_difference(const uint8_t *TOKT_RESTRICT one,
                                     const uint8_t *TOKT_RESTRICT other, ptrdiff_t n) {
    int sum = 0; /* in the form that compilers know an instruction for */
    for (ptrdiff_t i = 0; i < n; i++) sum += abs(one[i] - other[i]);
    return sum;
}

/* Write what `count` of the rows come to, patch by patch: the sum of levels, how many are bright,
 * the differences across and those down. */
TOKT_BODY void detail_rows_body(const DetailRows *detail, int count, int64_t *sums) {
    const AreaFrame *frame = detail->frame;
    int channels = frame->channels, lags = detail->count;
    ptrdiff_t stride = frame->stride, patch = (ptrdiff_t)(frame->width / detail->cols) * channels;
    for (int row = 0; row < count; row++)
        for (int col = 0; col < detail->cols; col++, sums += 2 + 2 * lags) {
            ptrdiff_t start = col * patch;
            const uint8_t *TOKT_RESTRICT here = frame->pixels + detail->rows[row] * stride + start;
            uint32_t level = 0, bright = 0;
            for (ptrdiff_t i = 0; i < patch; i++) {
                level += here[i];
                bright += here[i] >= DETAIL_BRIGHT;
            }
            sums[0] = level;
            sums[1] = bright;
            for (int lag = 0; lag < lags; lag++) {
                ptrdiff_t ahead = (ptrdiff_t)detail->lags[lag] * channels;
                ptrdiff_t n = stride - ahead - start < patch ? stride - ahead - start : patch;
                sums[2 + lag] = detail_difference(here, here + (n > 0 ? ahead : 0), n);
                const uint8_t *below = here + detail->lags[lag] * stride;
                sums[2 + lags + lag] = detail_difference(here, below, patch);
            }
        }
}

TOKT_VARIANTS(detail_rows, (const DetailRows *detail, int count, int64_t *sums),
              (detail, count, sums))

/* A 16-bit gray picture cut into equal patches. */
typedef struct {
    Gray16Picture picture;
    int cols, patch_height, patch_width;
} CurvaturePatches;

TOKT_BODY uint32_t curvature_square(int32_t before, int32_t here, int32_t after) {
    int32_t bend = before - 2 * here + after;
    bend = bend > DETAIL_MOST ? DETAIL_MOST : bend < -DETAIL_MOST ? -DETAIL_MOST : bend;
    return (uint32_t)(bend * bend);
}

/* Add the squares of a row of pixels and of those `step` before and behind each, column by column. */
TOKT_BODY void curvature_add_row(const uint16_t *here, ptrdiff_t step, int from, int to,
                                 uint32_t *TOKT_RESTRICT squares) {
    const uint16_t *before = here - step, *behind = here + step;
    for (int x = from; x < to; x++) squares[x] += curvature_square(before[x], here[x], behind[x]);
}

/* Uint32 values that `curvature_rows` needs as scratch. */
static size_t curvature_scratch(const CurvaturePatches *patches, int count) {
    return (size_t)count * patches->picture.width;
}

/* Write the sums of patch rows first..last for each lag. */
TOKT_BODY void curvature_rows_body(const CurvaturePatches *patches, const int32_t *lags, int count,
                                   int first, int last, uint32_t *scratch, int64_t *sums) {
    int width = patches->picture.width, height = patches->picture.height;
    size_t needed = curvature_scratch(patches, count) * sizeof(uint32_t);
    for (int row = first; row < last; row++) {
        int64_t *out = sums + (ptrdiff_t)row * patches->cols * count;
        int y = row * patches->patch_height, end = y + patches->patch_height;
        memset(out, 0, (size_t)patches->cols * count * sizeof(int64_t));
        while (y < end) {
            int stop = end - y > CURVATURE_ROWS ? y + CURVATURE_ROWS : end;
            memset(scratch, 0, needed);
            for (; y < stop; y++)
                for (int kind = 0; kind < count; kind++) {
                    int lag = lags[kind];
                    const uint16_t *here = patches->picture.pixels + (ptrdiff_t)y * width;
                    uint32_t *squares = scratch + (size_t)kind * width;
                    if (y >= lag && y + lag < height)
                        curvature_add_row(here, (ptrdiff_t)lag * width, 0, width, squares);
                    curvature_add_row(here, lag, lag, width - lag, squares);
                }
            for (int col = 0; col < patches->cols; col++)
                for (int kind = 0; kind < count; kind++) {
                    const uint32_t *squares =
                        scratch + (size_t)kind * width + (size_t)col * patches->patch_width;
                    for (int x = 0; x < patches->patch_width; x++) out[col * count + kind] += squares[x];
                }
        }
    }
}

TOKT_VARIANTS(curvature_rows,
              (const CurvaturePatches *patches, const int32_t *lags, int count, int first, int last,
               uint32_t *scratch, int64_t *sums),
              (patches, lags, count, first, last, scratch, sums))

#endif
