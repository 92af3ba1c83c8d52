/* Sums of a frame's pixels over boxes, where ranges of its rows and columns cross. */
#ifndef TOKT_BOXES_H
#define TOKT_BOXES_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "area.h"
#include "instructions.h"

enum { BOXES_ROWS = 256 /* whose sums fit 16 bits */ };

/* Uint16 values that `boxes_rows` needs as scratch. */
static size_t boxes_scratch(const AreaFrame *frame) { return (size_t)frame->stride; }

/* Write the sums of ranges first..last of the rows: each with `count` ranges of the columns. */
TOKT_BODY void boxes_rows_body(const AreaFrame *frame, const int64_t *rows, const int64_t *columns,
                               int count, int first, int last, uint16_t *TOKT_RESTRICT scratch,
                               int64_t *sums) {
    int channels = frame->channels;
    ptrdiff_t n = frame->stride;
    for (int row = first; row < last; row++) {
        int64_t *out = sums + (ptrdiff_t)row * count * channels;
        memset(out, 0, (size_t)count * channels * sizeof(int64_t));
        int64_t y = rows[2 * row], end = rows[2 * row + 1];
        while (y < end) {
            int64_t stop = end - y > BOXES_ROWS ? y + BOXES_ROWS : end;
            memset(scratch, 0, (size_t)n * sizeof(uint16_t));
            for (; y < stop; y++) {
                const uint8_t *TOKT_RESTRICT in = frame->pixels + y * n;
                for (ptrdiff_t x = 0; x < n; x++) scratch[x] = (uint16_t)(scratch[x] + in[x]);
            }
            for (int column = 0; column < count; column++)
                for (int channel = 0; channel < channels; channel++) {
                    int64_t sum = 0;
                    for (int64_t x = columns[2 * column]; x < columns[2 * column + 1]; x++)
                        sum += scratch[x * channels + channel];
                    out[column * channels + channel] += sum;
                }
        }
    }
}

TOKT_VARIANTS(boxes_rows,
              (const AreaFrame *frame, const int64_t *rows, const int64_t *columns, int count,
               int first, int last, uint16_t *scratch, int64_t *sums),
              (frame, rows, columns, count, first, last, scratch, sums))

#endif
