/* HMAC-SHA-256 (RFC 2104, FIPS 180-4), cut to its first 96 bits: the code of a commit. Leave this file out, and give
   no key, where commits need no code; then supply rt_code as an empty function. */

#include "retuner_device.h"

#include <string.h>

#define BLOCK 64u

static const uint32_t ROUND[64] = {
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5, 0xd807aa98,
    0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174, 0xe49b69c1, 0xefbe4786,
    0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da, 0x983e5152, 0xa831c66d, 0xb00327c8,
    0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967, 0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13,
    0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85, 0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819,
    0xd6990624, 0xf40e3585, 0x106aa070, 0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a,
    0x5b9cca4f, 0x682e6ff3, 0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7,
    0xc67178f2};

typedef struct {
    uint32_t state[8];
    uint32_t length;
    uint8_t block[BLOCK];
} hash;

static uint32_t rotated(uint32_t x, int n)
{
    return x >> n | x << (32 - n);
}

static void take_block(hash *h)
{
    uint32_t w[64], s[8];
    for (int i = 0; i < 16; i++)
        w[i] = (uint32_t)h->block[4 * i] << 24 | (uint32_t)h->block[4 * i + 1] << 16
               | (uint32_t)h->block[4 * i + 2] << 8 | h->block[4 * i + 3];
    for (int i = 16; i < 64; i++) {
        uint32_t a = w[i - 15], b = w[i - 2];
        w[i] = w[i - 16] + (rotated(a, 7) ^ rotated(a, 18) ^ a >> 3) + w[i - 7]
               + (rotated(b, 17) ^ rotated(b, 19) ^ b >> 10);
    }
    memcpy(s, h->state, sizeof s);
    for (int i = 0; i < 64; i++) {
        uint32_t choice = (s[4] & s[5]) ^ (~s[4] & s[6]), most = (s[0] & s[1]) ^ (s[0] & s[2]) ^ (s[1] & s[2]);
        uint32_t one = s[7] + (rotated(s[4], 6) ^ rotated(s[4], 11) ^ rotated(s[4], 25)) + choice + ROUND[i] + w[i];
        uint32_t two = (rotated(s[0], 2) ^ rotated(s[0], 13) ^ rotated(s[0], 22)) + most;
        memmove(s + 1, s, 7 * sizeof *s);
        s[4] += one;
        s[0] = one + two;
    }
    for (int i = 0; i < 8; i++)
        h->state[i] += s[i];
}

static void begin(hash *h)
{
    static const uint32_t first[8] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                                      0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
    memcpy(h->state, first, sizeof first);
    h->length = 0;
}

static void take(hash *h, const uint8_t *data, unsigned length)
{
    for (unsigned i = 0; i < length; i++) {
        h->block[h->length++ % BLOCK] = data[i];
        if (h->length % BLOCK == 0)
            take_block(h);
    }
}

static void end(hash *h, uint8_t digest[32])
{
    uint32_t bits = h->length * 8;
    uint8_t tail[4] = {(uint8_t)(bits >> 24), (uint8_t)(bits >> 16), (uint8_t)(bits >> 8), (uint8_t)bits};
    static const uint8_t one = 0x80, zero = 0;
    take(h, &one, 1);
    while (h->length % BLOCK != BLOCK - sizeof tail)
        take(h, &zero, 1);
    take(h, tail, sizeof tail);
    for (int i = 0; i < 32; i++)
        digest[i] = (uint8_t)(h->state[i / 4] >> (24 - 8 * (i % 4)));
}

/* The hash over the key's block (each byte exclusive-or `pad`) and what follows it. */
static void keyed(const uint8_t *key, unsigned key_length, uint8_t pad, const uint8_t *data, unsigned length,
                  uint8_t digest[32])
{
    hash h;
    uint8_t block[BLOCK] = {0};
    if (key_length > BLOCK) {
        begin(&h);
        take(&h, key, key_length);
        end(&h, block);
    } else
        memcpy(block, key, key_length);
    for (unsigned i = 0; i < BLOCK; i++)
        block[i] ^= pad;
    begin(&h);
    take(&h, block, BLOCK);
    take(&h, data, length);
    end(&h, digest);
}

void rt_code(const uint8_t *key, unsigned key_length, const uint8_t *message, unsigned length, uint64_t halves[2])
{
    uint8_t inner[32], outer[32];
    keyed(key, key_length, 0x36, message, length, inner);
    keyed(key, key_length, 0x5C, inner, sizeof inner, outer);
    for (int part = 0; part < 2; part++) {
        halves[part] = 0;
        for (int i = 5; i >= 0; i--)
            halves[part] = halves[part] << 8 | outer[6 * part + i];
    }
}
