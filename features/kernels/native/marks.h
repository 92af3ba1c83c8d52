/* Marks by which a picture is known again: hashes of pieces of rows, and signs of differences. */
#ifndef TOKT_MARKS_H
#define TOKT_MARKS_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "instructions.h"

enum { MARKS_TILE = 64 };

/* What is marked in a row: `pieces` of `words` 8 bytes each, and differences over `lag` pixels. */
typedef struct {
    int pieces, words, tiles, lag, largest;
    const uint64_t *weights;
} MarksKinds;

/* One bit of each of 64 bytes that are 0 or 1, the first one lowest. */
TOKT_BODY uint64_t marks_packed(const uint8_t *flags) {
    uint64_t bits = 0, eight;
    for (int byte = 0; byte < 8; byte++) {
        memcpy(&eight, flags + 8 * byte, 8);
        bits |= (eight * 0x0102040810204080u >> 56) << 8 * byte;
    }
    return bits;
}

/* Write the hashes of a row, and where it rises and where it falls. */
TOKT_BODY void marks_row_body(const uint8_t *row, const MarksKinds *kinds, uint64_t *hashes,
                              uint64_t *rising, uint64_t *falling) {
    for (int piece = 0; piece < kinds->pieces; piece++) {
        uint64_t sum = 0, word;
        for (int at = piece * kinds->words; at < (piece + 1) * kinds->words; at++) {
            memcpy(&word, row + 8 * (ptrdiff_t)at, 8);
            sum += word * kinds->weights[at];
        }
        hashes[piece] = sum;
    }
    for (int tile = 0; tile < kinds->tiles; tile++) {
        const uint8_t *one = row + (ptrdiff_t)tile * MARKS_TILE, *other = one + kinds->lag;
        uint8_t up[MARKS_TILE], down[MARKS_TILE];
        for (int x = 0; x < MARKS_TILE; x++) {
            int16_t step = (int16_t)(other[x] - one[x]);
            up[x] = (uint8_t)((step > 0) & (step <= kinds->largest));
            down[x] = (uint8_t)((step < 0) & (step >= -kinds->largest));
        }
        rising[tile] = marks_packed(up);
        falling[tile] = marks_packed(down);
    }
}

TOKT_VARIANTS_TO_AVX2(marks_row,
                      (const uint8_t *row, const MarksKinds *kinds, uint64_t *hashes,
                       uint64_t *rising, uint64_t *falling),
                      (row, kinds, hashes, rising, falling))

TOKT_BODY int64_t marks_ones(uint64_t bits) {
#if defined(__GNUC__)
    return __builtin_popcountll(bits);
#else
    bits -= bits >> 1 & 0x5555555555555555u;
    bits = (bits & 0x3333333333333333u) + (bits >> 2 & 0x3333333333333333u);
    return (int64_t)(((bits + (bits >> 4)) & 0x0f0f0f0f0f0f0f0fu) * 0x0101010101010101u >> 56);
#endif
}

/* Count where two pictures' signs, each `half` words of rises and as many of falls, are alike and
 * where they are opposite. */
TOKT_BODY void marks_counts_body(const uint64_t *one, const uint64_t *other, ptrdiff_t half,
                                 int64_t *counts) {
    int64_t alike = 0, opposite = 0;
    for (ptrdiff_t at = 0; at < half; at++) {
        alike += marks_ones(one[at] & other[at]) + marks_ones(one[at + half] & other[at + half]);
        opposite += marks_ones(one[at] & other[at + half]) + marks_ones(one[at + half] & other[at]);
    }
    counts[0] = alike;
    counts[1] = opposite;
}

TOKT_VARIANTS_TO_AVX2(marks_counts,
                      (const uint64_t *one, const uint64_t *other, ptrdiff_t half, int64_t *counts),
                      (one, other, half, counts))

#endif
