/* The device as a shared library, for tests on the machine where it is built: frames in, frames out, state. */

#include "retuner_device.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define FRAMES 64

typedef struct {
    rt_device device;
    rt_settings settings;
    rt_port port;
    rt_slot kept[RT_SLOTS];
    uint8_t key[64];
    uint64_t (*random)(void);
    int (*keep)(void); /* how the writing of a set ends: 1 it is there, 0 it failed, -1 bench_stored tells */
    const rt_slot *writing;
    int place;
    const char *refused;
    unsigned alive;
    rt_frame sent[FRAMES];
    int count;
} bench;

typedef struct {
    uint32_t sample, refused;
    uint16_t running, confirmed, latest, epoch, owner;
    uint8_t has_staged, is_auto;
    float running_gains[RT_GAINS], confirmed_gains[RT_GAINS], sp, co, load;
} bench_state;

static void on_send(void *context, const rt_frame *frame)
{
    bench *b = context;
    if (b->count < FRAMES)
        b->sent[b->count++] = *frame;
}

static void end_keep(bench *b, int is_there)
{
    if (is_there && b->writing)
        memcpy(&b->kept[b->place], b->writing, sizeof *b->writing);
    b->writing = NULL;
    rt_stored(&b->device, is_there != 0);
}

static void on_keep(void *context, int place, const rt_slot *slot)
{
    bench *b = context;
    int ends;
    memset(&b->kept[place], 0, sizeof b->kept[place]); /* it is being erased */
    b->writing = slot;
    b->place = place;
    ends = b->keep();
    if (ends >= 0)
        end_keep(b, ends);
}

static void on_alive(void *context)
{
    ((bench *)context)->alive++;
}

static uint64_t on_random(void *context)
{
    return ((bench *)context)->random();
}

/* What the stack holds before a call is nobody's business: it must not get out. */
static void dirty_stack(void)
{
    volatile uint8_t junk[2048];
    for (unsigned i = 0; i < sizeof junk; i++)
        junk[i] = 0xA5;
}

void bench_restart(bench *b, unsigned epoch, double pv, double co, double sp)
{
    b->count = 0;
    b->writing = NULL;
    dirty_stack();
    b->refused = rt_boot(&b->device, &b->settings, &b->port, (uint16_t)epoch, b->kept, (float)pv, (float)co, (float)sp);
}

/* The setting that was refused; NULL: none. */
const char *bench_refused(const bench *b)
{
    return b->refused;
}

/* The writing of a set has ended; the number of frames sent. */
int bench_stored(bench *b, int is_there)
{
    b->count = 0;
    end_keep(b, is_there);
    return b->count;
}

void bench_fault(bench *b, int is_fault)
{
    rt_fault(&b->device, is_fault != 0);
}

unsigned bench_alive(const bench *b)
{
    return b->alive;
}

/* A place as it would be written to flash. */
void bench_kept(const bench *b, int place, uint8_t *bytes)
{
    memcpy(bytes, &b->kept[place], sizeof b->kept[place]);
}

/* numbers: the settings in the order of rt_settings, without the key. */
bench *bench_new(const double *numbers, const uint8_t *key, unsigned key_length, uint64_t (*random)(void),
                 int (*keep)(void), unsigned epoch, double pv, double co)
{
    bench *b = calloc(1, sizeof *b);
    rt_settings *s = &b->settings;
    const double *at = numbers;
    int i;
    s->node = (uint8_t)*at++;
    s->sample_time_s = (float)*at++;
    for (i = 0; i < RT_GAINS; i++)
        s->gains.k[i] = (float)*at++;
    for (i = 0; i < RT_GAINS; i++)
        s->gain_max[i] = (float)*at++;
    s->ratio_max = (float)*at++;
    s->direction = (int8_t)*at++;
    s->sp_min = (float)*at++;
    s->sp_max = (float)*at++;
    s->co_min = (float)*at++;
    s->co_max = (float)*at++;
    s->co_rate_per_s = (float)*at++;
    s->co_fault = (float)*at++;
    s->b = (float)*at++;
    s->tau_f_s = (float)*at++;
    s->heartbeat_samples = (uint16_t)*at++;
    s->lease_longest_samples = (uint16_t)*at++;
    s->trial_samples = (uint16_t)*at++;
    memcpy(b->key, key, key_length);
    s->key = key_length ? b->key : NULL;
    s->key_length = (uint16_t)key_length;
    b->random = random;
    b->keep = keep;
    b->port.send = on_send;
    b->port.keep = on_keep;
    b->port.random = on_random;
    b->port.alive = on_alive;
    b->port.context = b;
    bench_restart(b, epoch, pv, co, NAN);
    return b;
}

void bench_free(bench *b)
{
    free(b);
}

/* Both return the number of frames sent. */
int bench_receive(bench *b, uint32_t id, int odd, unsigned length, const uint8_t *data)
{
    rt_frame frame;
    frame.id = id;
    frame.odd = odd != 0;
    frame.length = (uint8_t)length;
    memset(frame.data, 0, sizeof frame.data);
    memcpy(frame.data, data, length < 8 ? length : 8);
    b->count = 0;
    rt_receive(&b->device, &frame);
    return b->count;
}

int bench_sample(bench *b, double pv, double dt)
{
    b->count = 0;
    rt_sample(&b->device, (float)pv, (float)dt);
    return b->count;
}

uint32_t bench_sent(const bench *b, int number, uint8_t *data)
{
    memcpy(data, b->sent[number].data, 8);
    return b->sent[number].id | (uint32_t)b->sent[number].length << 16;
}

void bench_look(const bench *b, bench_state *state)
{
    const rt_device *d = &b->device;
    state->sample = d->sample;
    state->refused = d->refused;
    state->running = d->running.seq;
    state->confirmed = d->confirmed.seq;
    state->latest = d->latest;
    state->epoch = d->epoch;
    state->owner = d->owner;
    state->has_staged = d->has_staged;
    state->is_auto = d->is_auto;
    memcpy(state->running_gains, d->running.gains.k, sizeof state->running_gains);
    memcpy(state->confirmed_gains, d->confirmed.gains.k, sizeof state->confirmed_gains);
    state->sp = d->sp;
    state->co = d->co;
    state->load = d->load;
}

/* A place of the non-volatile memory as its bytes: generation u32, crc u32, seq u16, gains f32 x 3; false: never used. */
int bench_slot(const bench *b, int place, uint32_t *numbers, float *gains)
{
    const rt_slot *slot = &b->device.slots[place];
    numbers[0] = slot->generation;
    numbers[1] = slot->crc;
    numbers[2] = slot->content.seq;
    memcpy(gains, slot->content.gains.k, sizeof slot->content.gains.k);
    return slot->generation != 0;
}

/* Spoil it: power failed while it was written. */
void bench_spoil(bench *b, int place, uint32_t crc)
{
    b->kept[place].crc = b->device.slots[place].crc = crc;
}
