/* Area resize of a BGR or gray frame to a gray picture in 1/256 grey level, rounded once.
 *
 * A source pixel is `target` units long and a picture's pixel `source` units, so every overlap is
 * a whole number, and so is every sum: any order of adding gives the same bits. Whole rows are
 * added first, which a processor does many pixels at a time. The caller sees to it that a sum of
 * the largest frame stays below 2^31. */
#ifndef TOKT_GRAY16_H
#define TOKT_GRAY16_H

#include <stddef.h>
#include <stdint.h>

#include "area.h"
#include "instructions.h"

/* Which input rows (or columns) make one output row: those from `source`, one for each weight;
 * all weights of one output but the first and the last are the same. */
typedef struct {
    const int32_t *first;  /* [outputs + 1]: where an output's weights begin */
    const int32_t *source; /* [outputs]: its first input */
    const int32_t *weight; /* [all weights] */
} Gray16Table;

/* Whole numbers that a row of a picture needs as scratch; as in `area_scratch`. */
static size_t gray16_scratch(const AreaFrame *frame, int width) {
    return (size_t)frame->width * frame->channels + AREA_LANES + AREA_LANES * (size_t)width;
}

/* Add up the frame's rows that make row y of the picture. */
TOKT_BODY void gray16_add_rows(const AreaFrame *frame, const Gray16Table *rows, int y,
                               int32_t *TOKT_RESTRICT sums) {
    const int32_t *weight = rows->weight + rows->first[y];
    int n = frame->width * frame->channels, count = rows->first[y + 1] - rows->first[y];
    const uint8_t *TOKT_RESTRICT a = frame->pixels + rows->source[y] * frame->stride;
    int32_t part = weight[0], last = weight[count - 1];
    if (count == 4) {
        const uint8_t *TOKT_RESTRICT b = a + frame->stride, *TOKT_RESTRICT c = b + frame->stride;
        const uint8_t *TOKT_RESTRICT d = c + frame->stride;
        int32_t whole = weight[1];
        for (int x = 0; x < n; x++) sums[x] = part * a[x] + whole * (b[x] + c[x]) + last * d[x];
    } else if (count == 5) {
        const uint8_t *TOKT_RESTRICT b = a + frame->stride, *TOKT_RESTRICT c = b + frame->stride;
        const uint8_t *TOKT_RESTRICT d = c + frame->stride, *TOKT_RESTRICT e = d + frame->stride;
        int32_t whole = weight[1];
        for (int x = 0; x < n; x++)
            sums[x] = part * a[x] + whole * (b[x] + c[x] + d[x]) + last * e[x];
    } else {
        for (int x = 0; x < n; x++) sums[x] = part * a[x];
        for (int row = 1; row < count; row++) {
            const uint8_t *TOKT_RESTRICT in = a + row * frame->stride;
            int32_t more = weight[row];
            for (int x = 0; x < n; x++) sums[x] += more * in[x];
        }
    }
}

/* Add up the columns of `sums` that make each pixel of the picture's row; `ahead` as in
 * `area_add_columns`. */
TOKT_BODY void gray16_add_columns(const Gray16Table *columns, int channels, int width,
                                  const int32_t *sums, const uint8_t *ahead, ptrdiff_t n_ahead,
                                  int32_t *TOKT_RESTRICT out) {
    for (int x = 0; x < width; x++) {
        if ((ptrdiff_t)x * AREA_CACHE_LINE < n_ahead)
            TOKT_PREFETCH(ahead + (ptrdiff_t)x * AREA_CACHE_LINE);
        const int32_t *in = sums + (ptrdiff_t)columns->source[x] * channels;
        const int32_t *weight = columns->weight + columns->first[x];
        int count = columns->first[x + 1] - columns->first[x];
        if (channels == 1) {
            int32_t sum = 0;
            for (int i = 0; i < count; i++) sum += weight[i] * in[i];
            out[x] = sum;
            continue;
        }
        /* Blue, green and red go side by side; the fourth value is the next pixel's, and may run
         * over, so all are added without a sign. */
#if defined(__GNUC__)
        typedef uint32_t pixel __attribute__((vector_size(16), aligned(4), may_alias));
        pixel sum = {0};
        for (int i = 0; i < count; i++)
            sum += (uint32_t)weight[i] * *(const pixel *)(in + 3 * i);
        *(pixel *)(out + AREA_LANES * x) = sum;
#else
        uint32_t sum[AREA_LANES] = {0, 0, 0, 0};
        for (int i = 0; i < count; i++)
            for (int lane = 0; lane < AREA_LANES; lane++)
                sum[lane] += (uint32_t)weight[i] * (uint32_t)in[3 * i + lane];
        memcpy(out + AREA_LANES * x, sum, sizeof sum);
#endif
    }
}

/* Rows first..last of the 16-bit gray picture; `step` is what a weighted sum is multiplied by. */
TOKT_BODY void gray16_rows_body(const AreaFrame *frame, const Gray16Table *rows,
                                const Gray16Table *columns, int first, int last, int width,
                                double step, int32_t *scratch, uint16_t *out) {
    int32_t *sums = scratch, *along = sums + (size_t)frame->width * frame->channels + AREA_LANES;
    /* What follows a row is read as the fourth value of its last pixel. */
    for (int lane = 0; lane < AREA_LANES; lane++) along[lane - AREA_LANES] = 0;
    for (int y = first; y < last; y++) {
        uint16_t *TOKT_RESTRICT gray16 = out + (ptrdiff_t)y * width;
        gray16_add_rows(frame, rows, y, sums);
        int next = y + 1 < last ? y + 1 : y;
        gray16_add_columns(columns, frame->channels, width, sums,
                           frame->pixels + rows->source[next] * frame->stride,
                           (rows->first[next + 1] - rows->first[next]) * frame->stride, along);
        if (frame->channels == 1) {
            for (int x = 0; x < width; x++)
                gray16[x] = (uint16_t)(int32_t)(16384.0 * along[x] * step + 0.5);
            continue;
        }
        /* ITU-R BT.601 in 2^14 parts; the sum is exact below 2^53. */
        for (int x = 0; x < width; x++) {
            const int32_t *pixel = along + AREA_LANES * x;
            double gray = 1868.0 * pixel[0] + 9617.0 * pixel[1] + 4899.0 * pixel[2];
            gray16[x] = (uint16_t)(int32_t)(gray * step + 0.5);
        }
    }
}

TOKT_VARIANTS(gray16_rows,
              (const AreaFrame *frame, const Gray16Table *rows, const Gray16Table *columns,
               int first, int last, int width, double step, int32_t *scratch, uint16_t *out),
              (frame, rows, columns, first, last, width, step, scratch, out))

#endif
