/* A view's local contrast: the standard deviation around each pixel, and the view made even by it.
 *
 * The bits of OpenCV's `boxFilter` and `sqrBoxFilter`: sums in double precision that are carried
 * from pixel to pixel along a row and then from row to row down a column, in this order. Carried
 * alone, a row waits for each of its additions: several rows are carried side by side. */
#ifndef TOKT_CONTRAST_H
#define TOKT_CONTRAST_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "instructions.h"

enum { CONTRAST_ROWS = 4 /* that are carried side by side */ };
#define CONTRAST_WHOLE 12582912.0f /* 3 * 2^22: what is added to it is rounded to a whole number */

typedef struct {
    const float *view;
    int height, width; /* both larger than the window */
    int window;        /* height and width of what is around a pixel, odd, from 7 */
    float least;       /* grey levels that a smaller deviation counts as */
    float gain;        /* grey levels that one deviation becomes, around `CONTRAST_MIDDLE` */
} ContrastView;

/* Rows whose sums are kept: those around a pixel, and up to three made ahead. */
TOKT_BODY int contrast_kept(int window) {
    return (window + 2 * CONTRAST_ROWS - 2) / CONTRAST_ROWS * CONTRAST_ROWS;
}

/* Values of double that `contrast_view` needs as scratch: sums and totals, and two rows of floats. */
static size_t contrast_scratch(const ContrastView *view) {
    size_t rows = 2 * (size_t)contrast_kept(view->window) + 3;
    return rows * view->width + view->window;
}

/* A place beyond the picture's edge is its mirror image's. */
TOKT_BODY int contrast_mirrored(int at, int length) {
    at = at < 0 ? -at : at;
    return at < length ? at : 2 * (length - 1) - at;
}

/* Write a row's first sums over the window, and by how much each differs from the one before. */
TOKT_BODY void contrast_changes(const float *TOKT_RESTRICT row, const ContrastView *view,
                                float *TOKT_RESTRICT wide, double *TOKT_RESTRICT sums,
                                double *TOKT_RESTRICT squares) {
    int width = view->width, window = view->window, half = window / 2;
    memcpy(wide + half, row, (size_t)width * sizeof *row);
    for (int x = 0; x < half; x++) {
        wide[x] = row[half - x];
        wide[half + width + x] = row[width - 2 - x];
    }
    sums[0] = squares[0] = 0;
    for (int x = 0; x < window; x++) {
        sums[0] += (double)wide[x];
        squares[0] += (double)wide[x] * (double)wide[x];
    }
    const float *TOKT_RESTRICT entered = wide + window - 1, *TOKT_RESTRICT left = wide - 1;
    for (int x = 1; x < width; x++) {
        double enter = entered[x], leave = left[x];
        sums[x] = enter - leave;
        squares[x] = enter * enter - leave * leave;
    }
}

/* Make sums of the changes of rows that are `width` values long, one behind the other. */
TOKT_BODY void contrast_carry(double *TOKT_RESTRICT rows, ptrdiff_t width) {
    double sums[2 * CONTRAST_ROWS];
    for (int row = 0; row < 2 * CONTRAST_ROWS; row++) sums[row] = rows[row * width];
    for (int x = 1; x < width; x++)
        for (int row = 0; row < 2 * CONTRAST_ROWS; row++)
            rows[row * width + x] = sums[row] += rows[row * width + x];
}

/* Write the means and deviations of one row, whose totals lack the row `enter`; take `leave` away. */
TOKT_BODY void contrast_row(const ContrastView *view, const double *TOKT_RESTRICT enter,
                            const double *TOKT_RESTRICT leave, double *TOKT_RESTRICT totals,
                            float *TOKT_RESTRICT means, float *TOKT_RESTRICT sigma) {
    ptrdiff_t width = view->width;
    double share = 1.0 / (view->window * view->window);
    for (ptrdiff_t x = 0; x < width; x++) {
        double sum = totals[x] + enter[x], square = totals[width + x] + enter[width + x];
        float mean = (float)(sum * share), variance = (float)(square * share) - mean * mean;
        means[x] = mean;
        sigma[x] = sqrtf(variance > 0 ? variance : 0);
        totals[x] = sum - leave[x];
        totals[width + x] = square - leave[width + x];
    }
}

/* Write a row with the same contrast everywhere. */
TOKT_BODY void contrast_even(const ContrastView *view, const float *TOKT_RESTRICT row,
                             const float *TOKT_RESTRICT means, const float *TOKT_RESTRICT sigma,
                             uint8_t *TOKT_RESTRICT even) {
    float least = view->least, gain = view->gain;
    for (int x = 0; x < view->width; x++) {
        float level = (row[x] - means[x]) * gain / (sigma[x] > least ? sigma[x] : least) + 128;
        int32_t whole = (int32_t)(level + CONTRAST_WHOLE - CONTRAST_WHOLE);
        whole = whole > 0 ? whole : 0;
        even[x] = (uint8_t)(whole < 255 ? whole : 255);
    }
}

/* Write the deviations around all pixels, and the even view. */
TOKT_BODY void contrast_view_body(const ContrastView *view, double *scratch, float *sigma,
                                  uint8_t *even) {
    int width = view->width, height = view->height, half = view->window / 2;
    int kept = contrast_kept(view->window), made = 0;
    ptrdiff_t apart = 2 * (ptrdiff_t)width; /* from the sums of one row to those of the next */
    double *totals = scratch, *sums = totals + apart;
    float *means = (float *)(sums + kept * apart), *wide = means + width;
    memset(totals, 0, (size_t)apart * sizeof *totals);
    for (int y = -2 * half; y < height; y++) {
        for (int most = y > 0 ? y + half : half; made < height && made <= most;) {
            double *rows = sums + made % kept * apart;
            for (int row = 0; row < CONTRAST_ROWS; row++, made++) {
                double *sum = rows + row * apart;
                int last = made < height ? made : height - 1;
                contrast_changes(view->view + (ptrdiff_t)last * width, view, wide, sum, sum + width);
            }
            contrast_carry(rows, width);
        }
        const double *enter = sums + contrast_mirrored(y + half, height) % kept * apart;
        if (y < 0) {
            for (ptrdiff_t x = 0; x < apart; x++) totals[x] += enter[x];
            continue;
        }
        const double *leave = sums + contrast_mirrored(y - half, height) % kept * apart;
        ptrdiff_t at = (ptrdiff_t)y * width;
        contrast_row(view, enter, leave, totals, means, sigma + at);
        contrast_even(view, view->view + at, means, sigma + at, even + at);
    }
}

TOKT_VARIANTS_TO_AVX2(contrast_view,
                      (const ContrastView *view, double *scratch, float *sigma, uint8_t *even),
                      (view, scratch, sigma, even))

#endif
