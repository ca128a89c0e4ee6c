/* The checksum of commands and states: bit by bit over the struct in memory, its last word left out. */
#include <stddef.h>
#include <stdint.h>

static uint32_t checksum(const void *memory, size_t size) {
  const uint32_t *words = memory;
  uint32_t crc = 0xFFFFFFFF;
  for (size_t i = 0; i < size / 4 - 1; i++)
    for (int bit = 31; bit >= 0; bit--) {
      uint32_t top = (crc >> 31) ^ (words[i] >> bit & 1);
      crc = (crc << 1) ^ (top ? 0x04C11DB7 : 0);
    }
  return crc;
}
