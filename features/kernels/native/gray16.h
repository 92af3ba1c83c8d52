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

/* Whole numbers that a row of a picture needs as scratch; as in `area_scratch`. */
static size_t gray16_scratch(const AreaFrame *frame, int width) {
    return (size_t)frame->width * frame->channels + AREA_LANES + AREA_LANES * (size_t)width;
}

/* All weights of one output but the first and the last are the same. */
#define SUMS_NAME(name) gray16_##name
#define SUMS_TABLE Gray16Table
#define SUMS_VALUE int32_t
#define SUMS_LANE uint32_t
#include "area_sums.h"

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
        gray16_add_columns(frame, rows, next, columns, width, sums, along);
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
