/* The device on a microcontroller: fill in the functions of the board, and call what stands at the end from the
   interrupts of the CAN controller and of the sample timer, both of one priority (see README.md). */

#include "retuner_device.h"

#include <stddef.h>

/* ---- the board's functions */

/* Put a frame into a transmit buffer. What has no room may be dropped: the host asks again. */
static void board_send(void *context, const rt_frame *frame)
{
    (void)context;
    (void)frame; /* e.g. CAN->TX = ... with an 11-bit identifier, no remote request, frame->length bytes */
}

/* Begin to write a set to its place (0 or 1) in non-volatile memory and return: an erase takes up to seconds. The end is
   told with board_on_stored. Each place is a page of its own that may be erased while the other one stays. */
static void board_keep(void *context, int place, const rt_slot *slot)
{
    (void)context;
    (void)place;
    (void)slot; /* e.g. note it; the main loop erases FLASH page `place`, programs sizeof *slot bytes, reads them back */
}

/* An unforeseeable number of 48 bits, from the chip's random number generator; needed with a key only. */
static uint64_t board_random(void *context)
{
    (void)context;
    return 0;
}

/* A whole sample was made: here, and nowhere else, the watchdog is told so. */
static void board_alive(void *context)
{
    (void)context; /* e.g. IWDG->KR = 0xAAAA */
}

/* ---- what is burnt in */

static const rt_settings SETTINGS = {
    .node = 1,
    .sample_time_s = 0.01f,
    .gains = {{1.0f, 0.5f, 0.0f}},
    .gain_max = {20.0f, 20.0f, 1.0f},
    .ratio_max = 10.0f,
    .direction = 1,
    .sp_min = 0.0f,
    .sp_max = 100.0f,
    .co_min = 0.0f,
    .co_max = 100.0f,
    .co_fault = 0.0f,
    .b = 1.0f,
    .heartbeat_samples = 50,
    .lease_longest_samples = 600,
    .trial_samples = 500,
    .key = NULL,
};

static const rt_port PORT = {board_send, board_keep, board_random, board_alive, NULL};
static rt_device device;

/* At power-on: what the two places hold, the number of this boot (counted up in non-volatile memory), the first reading
   and the output in force, and the setpoint of before a reset where it is still known (else no number). NULL, or the
   setting that is wrong: then nothing runs. */
const char *board_start(const rt_slot slots[RT_SLOTS], uint16_t epoch, float pv, float co, float sp)
{
    return rt_boot(&device, &SETTINGS, &PORT, epoch, slots, pv, co, sp);
}

/* The set that board_keep was given is there and was read back right; false: it could not be written. */
void board_on_stored(bool is_there)
{
    rt_stored(&device, is_there);
}

/* The fault input has changed: over-temperature, a broken wire, an open contactor. */
void board_on_fault(bool is_fault)
{
    rt_fault(&device, is_fault);
}

/* The CAN controller has received a frame. */
void board_on_frame(const rt_frame *frame)
{
    rt_receive(&device, frame);
}

/* The sample timer: the reading in, the output to apply out. */
float board_on_sample(float pv)
{
    return rt_sample(&device, pv, SETTINGS.sample_time_s);
}
