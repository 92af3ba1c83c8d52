/* The pictures: every byte tells which camera and which moment it is of.
 *
 * Bytes 0..7 are the camera and the moment's number (seven bytes, least first); byte i > 7 is
 * (131 i + 17 moment + 89 camera) modulo 256. A torn, aliased or wrongly paired picture shows.
 */
#include "simulator.h"

void draw(uint8_t *buffer, uint32_t size, int camera, uint64_t moment)
{
    for (uint32_t i = 0; i < size; i++)
        buffer[i] = (uint8_t)(131 * i + 17 * moment + 89 * (uint64_t)camera);
    if (size < 8)
        return;
    buffer[0] = (uint8_t)camera;
    for (int i = 0; i < 7; i++)
        buffer[1 + i] = (uint8_t)(moment >> (8 * i));
}
