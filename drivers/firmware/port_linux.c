/* The device as a process on Linux, with a simulated plant: on SocketCAN in real time, or on a pipe in lock-step.

       retuner-firmware -i vcan0 [-n NODE] [-t SAMPLE_TIME_S] [-x SPEED] [-s STORE_FILE] [-k KEY_FILE] [-e EPOCH]
                        [-g DEAD_SAMPLES] [-w NOISE]
       retuner-firmware -p ...

   The plant answers after so many samples (0 to 63), and its sensor is wrong by up to so much.

   On a pipe every line on stdin is a frame, 021#0123456789ABCDEF as candump -L writes it, or the word sample: make one
   controller sample. Each is answered by the frames that it brings about, one a line, and an empty line. */

#define _DEFAULT_SOURCE
#define _POSIX_C_SOURCE 200809L

#include "retuner_device.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <math.h>
#include <net/if.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define KEY_LONGEST 64

/* The plant: a first-order lag, 1.2 pv units per percent and 30 s, at rest at 50 with co = 40. */
#define PLANT_GAIN 1.2f
#define PLANT_LAG_S 30.0f
#define PLANT_OFFSET 2.0f
#define PLANT_START_CO 40.0f
#define DEAD_MAX 64

typedef struct {
    rt_device device;
    rt_slot slots[RT_SLOTS];
    int socket; /* -1: a pipe */
    int store;  /* -1: nothing outlasts the process */
    float pv;
    float on_its_way[DEAD_MAX]; /* outputs that the plant has not felt yet */
    unsigned dead, samples;
    float noise;
    uint32_t chance;
    uint8_t key[KEY_LONGEST];
} machine;

static volatile sig_atomic_t is_over;

static void on_signal(int number)
{
    (void)number;
    is_over = 1;
}

static void fail(const char *what, const char *name)
{
    fprintf(stderr, "retuner-firmware: %s: %s: %s\n", name, what, errno ? strerror(errno) : "give another one");
    exit(2);
}

/* ---- the three functions of the port */

static void on_send(void *context, const rt_frame *frame)
{
    const machine *m = context;
    if (m->socket < 0) {
        printf("%03X#", (unsigned)frame->id);
        for (unsigned i = 0; i < frame->length; i++)
            printf("%02X", frame->data[i]);
        printf("\n");
        return;
    }
    struct can_frame raw;
    memset(&raw, 0, sizeof raw);
    raw.can_id = frame->id;
    raw.can_dlc = frame->length;
    memcpy(raw.data, frame->data, frame->length);
    if (write(m->socket, &raw, sizeof raw) < 0 && errno != ENOBUFS && errno != EINTR && errno != ENETDOWN)
        fail("cannot be written to", "CAN");
}

static void on_keep(void *context, int place, const rt_slot *slot)
{
    machine *m = context;
    rt_stored(&m->device,
              m->store < 0
                  || (pwrite(m->store, slot, sizeof *slot, (off_t)(place * (int)sizeof *slot)) == (ssize_t)sizeof *slot
                      && fsync(m->store) == 0));
}

static uint64_t on_random(void *context)
{
    uint64_t number = 0;
    int file = open("/dev/urandom", O_RDONLY);
    (void)context;
    if (file < 0 || read(file, &number, sizeof number) != (ssize_t)sizeof number)
        fail("gives no numbers", "/dev/urandom");
    close(file);
    return number;
}

/* ---- the process */

/* From -1 to 1; the same at every start (Marsaglia 2003, xorshift). */
static float chance(machine *m)
{
    m->chance ^= m->chance << 13;
    m->chance ^= m->chance >> 17;
    m->chance ^= m->chance << 5;
    return (float)m->chance / 2147483648.0f - 1.0f;
}

static void sample(machine *m, float dt)
{
    float aim, felt;
    m->on_its_way[m->samples % DEAD_MAX] = m->device.co;
    felt = m->on_its_way[(m->samples - m->dead) % DEAD_MAX];
    m->samples++;
    aim = PLANT_OFFSET + PLANT_GAIN * (felt + m->device.load);
    m->pv += (aim - m->pv) * (dt / (PLANT_LAG_S + dt));
    rt_sample(&m->device, m->noise > 0 ? m->pv + m->noise * chance(m) : m->pv, dt);
}

static int open_can(const char *name)
{
    struct ifreq request;
    struct sockaddr_can address;
    int handle = socket(PF_CAN, SOCK_RAW, CAN_RAW);
    if (handle < 0)
        fail("no CAN in this kernel", name);
    memset(&request, 0, sizeof request);
    strncpy(request.ifr_name, name, sizeof request.ifr_name - 1);
    memset(&address, 0, sizeof address);
    address.can_family = AF_CAN;
    if (ioctl(handle, SIOCGIFINDEX, &request) < 0)
        fail("no such interface", name);
    address.can_ifindex = request.ifr_ifindex;
    if (bind(handle, (struct sockaddr *)&address, sizeof address) < 0)
        fail("cannot be opened", name);
    return handle;
}

static void take_can(machine *m)
{
    struct can_frame raw;
    while (recv(m->socket, &raw, sizeof raw, MSG_DONTWAIT) == (ssize_t)sizeof raw) {
        rt_frame frame;
        frame.id = raw.can_id & CAN_EFF_MASK;
        frame.odd = (raw.can_id & (CAN_EFF_FLAG | CAN_RTR_FLAG | CAN_ERR_FLAG)) != 0;
        frame.length = raw.can_dlc;
        memcpy(frame.data, raw.data, sizeof frame.data);
        rt_receive(&m->device, &frame);
    }
}

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* A sample at every sample time from the first instant on, answers in between; missed instants are skipped. */
static void run_can(machine *m, double speed)
{
    double period_s = (double)m->device.settings.sample_time_s / speed, next_s = now_s() + period_s;
    struct pollfd watched;
    watched.fd = m->socket;
    watched.events = POLLIN;
    while (!is_over) {
        double left_s = next_s - now_s();
        if (left_s <= 0) {
            sample(m, m->device.settings.sample_time_s);
            do
                next_s += period_s;
            while (next_s < now_s() - period_s);
            continue;
        }
        if (poll(&watched, 1, (int)(1e3 * left_s) + 1) > 0)
            take_can(m);
    }
}

static void take_line(machine *m, const char *line)
{
    rt_frame frame;
    unsigned id, byte;
    int at = 0, used;
    memset(&frame, 0, sizeof frame);
    if (sscanf(line, "%x#%n", &id, &at) != 1 || at == 0) {
        fprintf(stderr, "retuner-firmware: %s is no frame; write 021#0123456789ABCDEF\n", line);
        exit(2);
    }
    frame.id = id;
    frame.odd = at != 4; /* three digits are an 11-bit identifier */
    while (frame.length < 8 && sscanf(line + at, "%2x%n", &byte, &used) == 1) {
        frame.data[frame.length++] = (uint8_t)byte;
        at += used;
    }
    rt_receive(&m->device, &frame);
}

static void run_pipe(machine *m)
{
    char line[64];
    while (!is_over && fgets(line, sizeof line, stdin)) {
        line[strcspn(line, "\n")] = 0;
        if (strcmp(line, "sample") == 0)
            sample(m, m->device.settings.sample_time_s);
        else
            take_line(m, line);
        printf("\n");
        fflush(stdout);
    }
}

static unsigned read_key(uint8_t *key, const char *path)
{
    FILE *file = fopen(path, "r");
    unsigned length = 0, byte;
    if (!file)
        fail("cannot be read", path);
    while (length < KEY_LONGEST && fscanf(file, "%2x", &byte) == 1)
        key[length++] = (uint8_t)byte;
    fclose(file);
    errno = 0;
    if (length < 16)
        fail("holds fewer than 32 hexadecimal digits", path);
    return length;
}

static rt_settings defaults(void)
{
    static const rt_settings settings = {
        .node = 1,
        .sample_time_s = 2.0f,
        .gains = {{1.0f, 0.0625f, 0.5f}},
        .gain_max = {20.0f, 2.0f, 5.0f},
        .ratio_max = 10.0f,
        .direction = 1,
        .sp_min = 0.0f,
        .sp_max = 120.0f,
        .co_min = 0.0f,
        .co_max = 100.0f,
        .b = 1.0f,
        .heartbeat_samples = 5,
        .lease_longest_samples = 600,
        .trial_samples = 60,
    };
    return settings;
}

int main(int count, char **given)
{
    static machine m;
    rt_settings settings = defaults();
    rt_port port = {on_send, on_keep, on_random, NULL, &m};
    const char *interface = NULL, *bad;
    double speed = 1.0;
    long epoch = (long)(on_random(NULL) & 0xFFFF);
    int option, is_pipe = 0;
    m.store = m.socket = -1;
    m.pv = 50.0f;
    m.chance = 2463534242u;
    for (option = 0; option < DEAD_MAX; option++)
        m.on_its_way[option] = PLANT_START_CO;
    while ((option = getopt(count, given, "i:pn:t:x:s:k:e:g:w:")) != -1) {
        switch (option) {
        case 'i': interface = optarg; break;
        case 'p': is_pipe = 1; break;
        case 'n': settings.node = (uint8_t)atoi(optarg); break;
        case 't': settings.sample_time_s = (float)atof(optarg); break;
        case 'x': speed = atof(optarg); break;
        case 'g': m.dead = (unsigned)atoi(optarg); break;
        case 'w': m.noise = (float)atof(optarg); break;
        case 'e': epoch = atol(optarg); break;
        case 'k':
            settings.key = m.key;
            settings.key_length = (uint16_t)read_key(m.key, optarg);
            break;
        case 's':
            m.store = open(optarg, O_RDWR | O_CREAT, 0600);
            if (m.store < 0)
                fail("cannot be opened", optarg);
            if (read(m.store, m.slots, sizeof m.slots) < 0)
                fail("cannot be read", optarg);
            break;
        default: return 2;
        }
    }
    if (is_pipe == (interface != NULL) || settings.node < 1 || settings.node > 63 || !(settings.sample_time_s > 0)
        || !(speed > 0) || m.dead >= DEAD_MAX || !(m.noise >= 0)) {
        fprintf(stderr, "retuner-firmware: give -i INTERFACE or -p; -n 1 to 63; -t, -x positive; -g to 63; -w 0 or more\n");
        return 2;
    }
    if (settings.sample_time_s * 600.0f < 6.0f) /* a host asks for 3 s */
        settings.lease_longest_samples = (uint16_t)(settings.sample_time_s > 1e-4f ? 6.0f / settings.sample_time_s : 6e4f);
    signal(SIGTERM, on_signal);
    signal(SIGINT, on_signal);
    if (!is_pipe)
        m.socket = open_can(interface);
    bad = rt_boot(&m.device, &settings, &port, (uint16_t)epoch, m.slots, m.pv, PLANT_START_CO, NAN);
    if (bad) {
        fprintf(stderr, "retuner-firmware: %s is outside its range; see retuner_device.h\n", bad);
        return 2;
    }
    if (is_pipe)
        run_pipe(&m);
    else
        run_can(&m, speed);
    return 0;
}
