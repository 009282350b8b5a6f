/* A PID controller that speaks the retuner protocol, version 3 (docs/developers/protocol.md), for any microcontroller with CAN.

   Portable C99, float32, no allocation, no clock, no operating system. The application calls

       rt_boot      once, with its settings and what its non-volatile memory holds
       rt_receive   for every frame that comes
       rt_sample    once a controller sample, between reading the sensor and setting the actuator
       rt_stored    when a set that was to be kept is there, or could not be written
       rt_fault     when a fault input is set or cleared

   and gives up to four functions: send a frame, begin to keep a set, make a random number (only where commits need a
   code), and tell a watchdog that a sample was made. These calls must not interrupt one another: make them from one
   priority, or mask the others meanwhile. */

#ifndef RETUNER_DEVICE_H
#define RETUNER_DEVICE_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define RT_PROTOCOL_VERSION 3u
#define RT_LAYOUT_HASH 0xecf6u /* of drivers/retuner.dbc; both ends compare it */
#define RT_SLOTS 2
#define RT_GAINS 3
#define RT_HALVES_KEPT 4

/* A frame of classic CAN with an 11-bit identifier. `odd` marks whatever else came under this identifier (remote,
   extended, error or FD frame): it is counted as refused. */
typedef struct {
    uint32_t id;
    uint8_t length;
    bool odd;
    uint8_t data[8];
} rt_frame;

/* Gains of the parallel form: co = kp (b sp - pv) + ki integral(sp - pv) dt - kd d(pv)/dt. Order: kp, ki, kd. */
typedef struct {
    float k[RT_GAINS];
} rt_gains;

/* A complete set and its sequence number. */
typedef struct {
    uint16_t seq;
    uint16_t spare; /* always 0: what is written to flash has no byte that nobody set */
    rt_gains gains;
} rt_set;

/* One of the two places for a set in non-volatile memory. A place whose crc is wrong (an erased one, too) is empty. */
typedef struct {
    uint32_t generation;
    uint32_t crc;
    rt_set content;
} rt_slot;

/* What is burnt in. Times in s, co in percent of the output range, pv and sp in units of pv. */
typedef struct {
    uint8_t node;                   /* 1 to 63 */
    float sample_time_s;            /* what IDENTITY says */
    rt_gains gains;                 /* run when nothing is stored */
    float gain_max[RT_GAINS];       /* largest magnitudes that are accepted */
    float ratio_max;                /* largest factor, up or down, of one write; 1 or more */
    int8_t direction;               /* +1 or -1: the only sign that gains may have; 0: either */
    float sp_min, sp_max;           /* setpoints that are accepted */
    float co_min, co_max;           /* range of the output, within -100 to 200 */
    float co_rate_per_s;            /* largest rate of the output; 0: no limit */
    float co_fault;                 /* output while a fault is told, limited to the range, at once */
    float b;                        /* setpoint weight, 0 to 1 */
    float tau_f_s;                  /* filter time of the derivative */
    uint16_t heartbeat_samples;     /* between life signs; 1 to 100 */
    uint16_t lease_longest_samples; /* longest lease that is granted; 1 or more */
    uint16_t trial_samples;         /* within which a set must be confirmed, else the confirmed one runs again; 0: off */
    const uint8_t *key;             /* secret that commits are authenticated with; NULL: none */
    uint16_t key_length;            /* bytes, at least 16 */
} rt_settings;

/* What the application does for the device. */
typedef struct {
    void (*send)(void *context, const rt_frame *frame);
    /* Begin to write a set into non-volatile memory and return; rt_stored tells how it ended. It stays where it is until
       then. Called from within rt_receive, so an erase of a second belongs elsewhere. */
    void (*keep)(void *context, int place, const rt_slot *slot);
    uint64_t (*random)(void *context); /* unforeseeable; may be NULL without a key */
    void (*alive)(void *context);      /* a whole sample was made: the watchdog's; may be NULL */
    void *context;
} rt_port;

/* The PID law's memory from one sample to the next. */
typedef struct {
    float integral, pv, pv_rate, co;
    int8_t limited;
} rt_law;

/* A COMMIT, SETPOINT, MODE, LOAD or LEASE as it came, to know a repeated one. */
typedef struct {
    bool there;
    uint8_t data[8];
} rt_heard;

typedef struct {
    rt_settings settings;
    rt_port port;
    uint16_t epoch;
    uint32_t sample;
    uint32_t refused;
    bool is_ready; /* the settings were good: without them nothing is said and co stays */
    /* the loop */
    float sp, pv, co, manual_co, load;
    bool is_auto;
    bool is_blind;   /* the last reading was no number */
    bool is_fault;   /* as rt_fault told */
    bool has_begun;  /* there was a reading since the boot */
    bool is_sp_told; /* by the application at the boot, or by a host */
    rt_law law;
    rt_heard commands[3];
    /* gain sets */
    rt_slot slots[RT_SLOTS], storing;
    int8_t storing_place; /* -1: nothing is being stored */
    rt_set running, confirmed, pending;
    rt_heard commit_of_running, commit_pending, commit_refused;
    uint8_t refusal[8]; /* the answer to commit_refused */
    uint16_t latest, staged_seq, trial_left;
    bool has_staged;
    uint8_t staged_items; /* a bit for each gain that is there */
    float staged[RT_GAINS];
    /* lease */
    uint16_t owner, lease_left;
    rt_heard lease;
    /* codes */
    uint64_t nonce;
    uint32_t wrong_codes;
    uint64_t halves[2][RT_HALVES_KEPT];
    uint8_t half_seq[2][RT_HALVES_KEPT], half_count[2], half_next[2];
} rt_device;

/* Power-on: run the newest whole set of `slots`, else the commissioned one, in auto and at rest at pv with output co.
   epoch: number of this boot, never one that was used lately: count it up in non-volatile memory or make it random.
   pv: the first reading; no number where there is none yet: the law begins with the first that is one.
   co: the output in force; no number: co_fault.
   sp: the setpoint to begin with, e.g. that of before a watchdog's reset; no number: the first pv. It is limited to the
   range of setpoints.
   Returns NULL, or the name of the first setting that is outside its range: then the device says nothing, and rt_sample
   gives co back. */
const char *rt_boot(rt_device *device, const rt_settings *settings, const rt_port *port, uint16_t epoch,
                    const rt_slot slots[RT_SLOTS], float pv, float co, float sp);

/* Take a frame; answers are sent at once. Anything whatsoever may come. */
void rt_receive(rt_device *device, const rt_frame *frame);

/* One controller sample of dt seconds with this reading: swap a committed set in, work out co, send the telemetry. The
   co to apply until the next sample is returned. A reading that is no number, or beyond 1e9, is passed over: HEARTBEAT
   tells, co stays in automatic, manual goes on, and a set waits for the next number to be swapped in. */
float rt_sample(rt_device *device, float pv, float dt);

/* The set that `keep` was given is there, or could not be written. May be called from within `keep`. The answer to STORE
   is sent now. */
void rt_stored(rt_device *device, bool is_there);

/* A fault is there, or is over: from the next sample on co is co_fault, or goes on from there without a bump. */
void rt_fault(rt_device *device, bool is_fault);

/* CRC-32 (zlib's), continued from crc; begin with 0. */
uint32_t rt_crc32(uint32_t crc, const uint8_t *data, unsigned length);

/* The first 96 bits of HMAC-SHA-256 over `message`: low half, high half (retuner_code.c). */
void rt_code(const uint8_t *key, unsigned key_length, const uint8_t *message, unsigned length, uint64_t halves[2]);

#ifdef __cplusplus
}
#endif

#endif
