/* The device's side of the retuner protocol and the PID law behind it: see retuner_device.h and docs/developers/protocol.md.

   The promise: the running set is always one that was committed complete, newer than its predecessor, built on it, with
   the right CRC-32 and inside the box; it changes between reading pv and working out co of one sample. */

#include "retuner_device.h"

#include <math.h>
#include <string.h>

enum {
    LEASE = 1, READ, ABORT, STAGE, COMMIT, STORE, CONFIRM, SETPOINT, MODE, LOAD, AUTH,
    HEARTBEAT = 16, STATUS, TELEMETRY_PV, TELEMETRY_SP, IDENTITY, ITEM, PAGE, ACK, CHALLENGE
};

enum { PAGE_RUNNING, PAGE_STAGED, PAGE_STORED, PAGE_IDENTITY, PAGE_CHALLENGE };

enum {
    OK, STALE, WRONG_BASE, WRONG_CRC, INCOMPLETE, NOT_FINITE, OUTSIDE_BOX, RATIO, BUSY, ALREADY_RUNNING, OUT_OF_RANGE,
    WRONG_KEY, NOT_STAGED, NOT_OWNER, NOT_CONFIRMED, REVERTED, NO_CODE, WRONG_CODE, NOT_STORED
};

enum {
    FLAG_AUTO = 1, FLAG_STAGED = 2, FLAG_STORED = 4, FLAG_TRIAL = 8, FLAG_OWNED = 16, FLAG_WRONG_CODE = 32,
    FLAG_BLIND = 64, FLAG_FAULT = 128
};

#define COMMAND_BITS 5
#define NOBODY 0u
#define STORE_KEY 0x65766173u /* "save" */
#define STAMP_SAMPLES 64u
#define ALL_ITEMS 7u
#define VALUE_MAX 1e12f /* ranges of drivers/retuner.dbc */
#define SP_MAX 1e9f
#define PV_MAX 1e9f
#define LOAD_MAX 1e3f
#define CO_LOW (-1000000)
#define CO_HIGH 2000000
#define CO_STEPS 10000.0f /* steps of co on the wire per percent */
#define SAMPLE_TIME_MIN_S 1e-4f
#define SAMPLE_TIME_MAX_S 3600.0f
#define HEARTBEAT_SAMPLES_MAX 100u
#define NODE_MAX 63u
#define KEY_LENGTH_MIN 16u

/* ---- bytes, low one first */

static void put16(uint8_t *at, uint32_t value)
{
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
}

static void put32(uint8_t *at, uint32_t value)
{
    put16(at, value);
    put16(at + 2, value >> 16);
}

static void put_float(uint8_t *at, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    put32(at, bits);
}

static uint16_t get16(const uint8_t *at)
{
    return (uint16_t)(at[0] | (unsigned)at[1] << 8); /* an int of 16 bits has no room for it */
}

static uint32_t get32(const uint8_t *at)
{
    return get16(at) | (uint32_t)get16(at + 2) << 16;
}

static float get_float(const uint8_t *at)
{
    uint32_t bits = get32(at);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static uint64_t get48(const uint8_t *at)
{
    return get32(at) | (uint64_t)get16(at + 4) << 32;
}

/* ---- checks */

/* CRC-8 SAE J1850 over the identifier (low byte first) and the bytes of the frame before the checksum. */
static uint8_t frame_crc(uint32_t id, const uint8_t *data, unsigned length)
{
    uint8_t crc = 0xFF;
    for (unsigned i = 0; i < length + 2; i++) {
        crc = (uint8_t)(crc ^ (i < 2 ? id >> 8 * i : data[i - 2]));
        for (int bit = 0; bit < 8; bit++)
            crc = (uint8_t)(crc << 1 ^ (crc & 0x80 ? 0x1D : 0));
    }
    return crc ^ 0xFF;
}

/* CRC-16-CCITT, start 0xFFFF. */
static uint16_t crc16(const uint8_t *data, unsigned length)
{
    uint16_t crc = 0xFFFF;
    for (unsigned i = 0; i < length; i++) {
        crc ^= (uint16_t)((unsigned)data[i] << 8);
        for (int bit = 0; bit < 8; bit++)
            crc = (uint16_t)(crc << 1 ^ (crc & 0x8000 ? 0x1021 : 0));
    }
    return crc;
}

uint32_t rt_crc32(uint32_t crc, const uint8_t *data, unsigned length)
{
    crc = ~crc;
    for (unsigned i = 0; i < length; i++) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; bit++)
            crc = crc >> 1 ^ (crc & 1 ? 0xEDB88320u : 0);
    }
    return ~crc;
}

static void put_gains(uint8_t *at, const float *k)
{
    for (int i = 0; i < RT_GAINS; i++)
        put_float(at + 4 * i, k[i]);
}

static uint32_t set_crc(const rt_device *d, uint16_t seq, const float *k)
{
    uint8_t said[17];
    said[0] = d->settings.node;
    put16(said + 1, d->epoch);
    put16(said + 3, seq);
    put_gains(said + 5, k);
    return rt_crc32(0, said, sizeof said);
}

static uint32_t slot_crc(const rt_slot *slot)
{
    uint8_t said[18];
    put32(said, slot->generation);
    put16(said + 4, slot->content.seq);
    put_gains(said + 6, slot->content.gains.k);
    return rt_crc32(0, said, sizeof said);
}

static uint16_t lease_stamp(uint16_t epoch, uint32_t sample)
{
    uint8_t said[6];
    put16(said, epoch);
    put32(said + 2, sample / STAMP_SAMPLES);
    return crc16(said, sizeof said);
}

/* Whether a wrapping number is newer than another: less than half the circle ahead (RFC 1982). */
static bool newer16(uint16_t number, uint16_t than)
{
    uint16_t ahead = (uint16_t)(number - than);
    return ahead > 0 && ahead < 0x8000;
}

static bool newer8(uint8_t number, uint8_t than)
{
    uint8_t ahead = (uint8_t)(number - than);
    return ahead > 0 && ahead < 0x80;
}

/* ---- sending */

static void send(rt_device *d, unsigned command, unsigned length, uint8_t *data, bool is_checked)
{
    rt_frame frame;
    frame.id = (uint32_t)d->settings.node << COMMAND_BITS | command;
    frame.length = (uint8_t)length;
    frame.odd = false;
    memset(frame.data, 0, sizeof frame.data);
    if (is_checked)
        data[length - 1] = frame_crc(frame.id, data, length - 1);
    memcpy(frame.data, data, length);
    d->port.send(d->port.context, &frame);
}

static void make_ack(const rt_device *d, uint8_t *data, unsigned kind, unsigned seq, unsigned reason, unsigned latest,
                     unsigned item)
{
    uint32_t head = kind | item << 4 | reason << 6 | (uint32_t)(d->epoch & 0x1FFF) << 11;
    data[0] = (uint8_t)head;
    put16(data + 1, head >> 8);
    put16(data + 3, seq);
    put16(data + 5, latest);
}

static void ack(rt_device *d, unsigned kind, unsigned seq, unsigned reason, unsigned latest, unsigned item)
{
    uint8_t data[8];
    make_ack(d, data, kind, seq, reason, latest, item);
    send(d, ACK, 8, data, true);
}

/* An answer about a gain set: it tells the newest number seen. */
static void ack_set(rt_device *d, unsigned kind, unsigned seq, unsigned reason)
{
    ack(d, kind, seq, reason, d->latest, 0);
}

/* ---- frames as they came, to know them again */

static bool is_same(const rt_heard *heard, const uint8_t *data)
{
    return heard->there && memcmp(heard->data, data, sizeof heard->data) == 0;
}

static void note(rt_heard *heard, const uint8_t *data)
{
    heard->there = true;
    memcpy(heard->data, data, sizeof heard->data);
}

/* ---- the PID law (schedule/pid.py tells where it comes from) */

static float clip(float value, float low, float high)
{
    return value < low ? low : value > high ? high : value;
}

static bool is_within(float value, float limit)
{
    return value >= -limit && value <= limit; /* no number fails it, too */
}

static int8_t standing(const rt_settings *s, float co)
{
    return co >= s->co_max ? 1 : co <= s->co_min ? -1 : 0;
}

static float pv_rate(const rt_device *d, float pv, float dt)
{
    float tau = d->settings.tau_f_s;
    return (tau * d->law.pv_rate + pv - d->law.pv) / (tau + dt);
}

static float wish_of(const rt_device *d, const rt_gains *gains, float pv, float rate)
{
    return gains->k[0] * (d->settings.b * d->sp - pv) + d->law.integral - gains->k[2] * rate;
}

static void start_law(rt_device *d, float pv, float co)
{
    const float *k = d->running.gains.k;
    co = clip(co, d->settings.co_min, d->settings.co_max);
    d->law.integral = co - k[0] * (d->settings.b * d->sp - pv);
    d->law.pv = pv;
    d->law.pv_rate = 0.0f;
    d->law.co = co;
    d->law.limited = standing(&d->settings, co);
}

/* Other gains, and co as it would have been: I+ = I + P - P+ + D - D+; at a limit co stays there. */
static void change_law(rt_device *d, const rt_gains *old, float pv, float dt)
{
    const rt_settings *s = &d->settings;
    float rate = pv_rate(d, pv, dt);
    float after = wish_of(d, &d->running.gains, pv, rate);
    float aim = clip(wish_of(d, old, pv, rate), s->co_min, s->co_max);
    bool stays = aim >= s->co_max ? after >= aim : aim <= s->co_min && after <= aim;
    if (!stays && isfinite(aim - after))
        d->law.integral += aim - after;
}

/* One sample in automatic. Anti-windup: the integral does not grow in the direction in which co cannot follow. */
static void step_law(rt_device *d, float pv, float dt)
{
    const rt_settings *s = &d->settings;
    float rate = pv_rate(d, pv, dt);
    float wish = wish_of(d, &d->running.gains, pv, rate);
    float more = d->running.gains.k[1] * (d->sp - pv) * dt;
    float reach = s->co_rate_per_s * dt;
    float co = reach > 0.0f ? clip(wish, d->law.co - reach, d->law.co + reach) : wish;
    if (!isfinite(wish + more))
        return;
    co = clip(co, s->co_min, s->co_max);
    if (more > 0.0f)
        more = wish > co ? 0.0f : wish + more <= s->co_max ? more : s->co_max - wish;
    else
        more = wish < co ? 0.0f : wish + more >= s->co_min ? more : s->co_min - wish;
    d->law.integral += more;
    d->law.pv = pv;
    d->law.pv_rate = rate;
    d->law.co = co;
    d->law.limited = standing(s, co);
}

/* One sample with a given output, to be reached so far at most (0: at once): the integral follows, so that automatic
   goes on from there. */
static void track_law(rt_device *d, float wanted, float reach, float pv, float dt)
{
    const rt_settings *s = &d->settings;
    float rate = pv_rate(d, pv, dt);
    float co = reach > 0.0f ? clip(wanted, d->law.co - reach, d->law.co + reach) : wanted;
    co = clip(co, s->co_min, s->co_max);
    d->law.integral = 0.0f; /* a large one would hide what is added to it */
    d->law.integral = co - wish_of(d, &d->running.gains, pv, rate);
    d->law.pv = pv;
    d->law.pv_rate = rate;
    d->law.co = co;
    d->law.limited = standing(s, co);
}

/* ---- the memory of gain sets */

static bool is_whole(const rt_slot *slot)
{
    return slot->generation > 0 && slot->crc == slot_crc(slot);
}

static bool is_equal(const rt_set *a, const rt_set *b)
{
    return a->seq == b->seq && memcmp(a->gains.k, b->gains.k, sizeof a->gains.k) == 0;
}

/* What a restart would run. */
static rt_set stored(const rt_device *d)
{
    const rt_slot *newest = 0;
    rt_set first = {0};
    for (int i = 0; i < RT_SLOTS; i++)
        if (is_whole(&d->slots[i]) && (!newest || d->slots[i].generation > newest->generation))
            newest = &d->slots[i];
    if (newest)
        return newest->content;
    first.seq = 0;
    first.gains = d->settings.gains;
    return first;
}

static bool is_stored(const rt_device *d)
{
    for (int i = 0; i < RT_SLOTS; i++)
        if (is_whole(&d->slots[i]) && is_equal(&d->slots[i].content, &d->running))
            return true;
    return false;
}

static bool on_trial(const rt_device *d)
{
    return !is_equal(&d->running, &d->confirmed);
}

static void forget_staged(rt_device *d)
{
    d->has_staged = false;
    d->staged_items = 0;
}

/* Whoever was staging may not command any more; an accepted commit stays accepted. */
static void drop_staged(rt_device *d)
{
    if (!d->commit_pending.there)
        forget_staged(d);
}

static void renew_challenge(rt_device *d)
{
    d->nonce = d->port.random ? d->port.random(d->port.context) & 0xFFFFFFFFFFFFu : 0;
    memset(d->half_count, 0, sizeof d->half_count);
    memset(d->half_next, 0, sizeof d->half_next);
}

static void on_stage(rt_device *d, const uint8_t *data)
{
    unsigned item = data[0] & 3, tag = data[0] >> 2;
    uint16_t seq = get16(data + 5);
    unsigned reason = OK;
    if (d->owner == NOBODY || tag != (d->owner & 63u))
        reason = NOT_OWNER;
    else if (d->commit_pending.there)
        reason = BUSY;
    else if (!(d->has_staged && seq == d->staged_seq) && !newer16(seq, d->latest))
        reason = STALE;
    if (reason != OK) {
        ack(d, STAGE, seq, reason, d->latest, item);
        return;
    }
    if (!(d->has_staged && seq == d->staged_seq)) {
        forget_staged(d);
        d->has_staged = true;
        d->staged_seq = d->latest = seq;
    }
    d->staged[item] = get_float(data + 1);
    d->staged_items |= (uint8_t)(1u << item);
}

/* Whether a PID can run them: not all zero, and of one sign. */
static bool is_pid(const float *k)
{
    bool up = false, down = false;
    for (int i = 0; i < RT_GAINS; i++) {
        up = up || k[i] > 0.0f;
        down = down || k[i] < 0.0f;
    }
    return up != down;
}

/* Why the staged gains may not follow the running ones; the item at fault. */
static unsigned box_refusal(const rt_device *d, unsigned *item)
{
    const rt_settings *s = &d->settings;
    unsigned i;
    for (i = 0; i < RT_GAINS; i++) {
        float k = d->staged[i];
        *item = i;
        if (!isfinite(k))
            return NOT_FINITE;
        if (fabsf(k) > s->gain_max[i] || k * (float)s->direction < 0.0f)
            return OUTSIDE_BOX;
    }
    *item = 0;
    if (!is_pid(d->staged))
        return OUTSIDE_BOX;
    for (i = 0; i < RT_GAINS; i++) {
        float old = d->running.gains.k[i], ratio = d->staged[i] / (old != 0.0f ? old : 1.0f);
        *item = i;
        if (old != 0.0f && d->staged[i] != 0.0f && !(ratio >= 1.0f / s->ratio_max && ratio <= s->ratio_max))
            return RATIO;
    }
    *item = 0;
    return OK;
}

static bool is_among(const rt_device *d, unsigned part, uint8_t seq_tag, uint64_t right, bool *came)
{
    uint64_t wrong_bits = 1;
    for (unsigned i = 0; i < d->half_count[part]; i++)
        if (d->half_seq[part][i] == seq_tag) {
            *came = true;
            if (!(d->halves[part][i] ^ right))
                wrong_bits = 0;
        }
    return !wrong_bits;
}

/* Whether the code of this commit has come, both halves of it, whatever other halves came beside them. */
static unsigned code_refusal(rt_device *d, uint16_t seq, uint16_t base)
{
    static const char label[] = "retuner commit 2";
    uint8_t said[sizeof label - 1 + 29];
    uint8_t *at = said + sizeof label - 1;
    uint64_t right[2];
    bool low_came = false, high_came = false, low, high;
    if (!d->settings.key)
        return OK;
    memcpy(said, label, sizeof label - 1);
    at[0] = d->settings.node;
    put16(at + 1, d->epoch);
    put32(at + 3, (uint32_t)d->nonce);
    put32(at + 7, (uint32_t)(d->nonce >> 32));
    put16(at + 11, d->owner);
    put16(at + 13, seq);
    put16(at + 15, base);
    put_gains(at + 17, d->staged);
    rt_code(d->settings.key, d->settings.key_length, said, sizeof said, right);
    low = is_among(d, 0, seq & 15, right[0], &low_came);
    high = is_among(d, 1, seq & 15, right[1], &high_came);
    if (!(low_came && high_came))
        return NO_CODE;
    if (low && high) {
        renew_challenge(d);
        return OK;
    }
    d->wrong_codes++;
    return WRONG_CODE;
}

/* Every condition of a commit, in the order in which they are told. */
static unsigned commit_refusal(rt_device *d, uint16_t seq, uint16_t base, uint32_t crc, unsigned *item)
{
    uint8_t said[4];
    unsigned reason;
    *item = 0;
    if (base != d->running.seq)
        return WRONG_BASE;
    if (d->staged_items != ALL_ITEMS) {
        while (d->staged_items >> *item & 1)
            ++*item;
        return INCOMPLETE;
    }
    reason = box_refusal(d, item);
    if (reason != OK)
        return reason;
    put16(said, base);
    put16(said + 2, d->owner);
    if (crc != rt_crc32(set_crc(d, seq, d->staged), said, sizeof said))
        return WRONG_CRC;
    return code_refusal(d, seq, base);
}

static void on_commit(rt_device *d, const uint8_t *data)
{
    uint16_t seq = get16(data);
    unsigned reason, item;
    if (is_same(&d->commit_of_running, data)) {
        ack_set(d, COMMIT, seq, OK);
        return;
    }
    if (d->commit_pending.there) {
        if (!is_same(&d->commit_pending, data))
            ack_set(d, COMMIT, seq, BUSY);
        return;
    }
    if (is_same(&d->commit_refused, data)) {
        send(d, ACK, 8, d->refusal, true);
        return;
    }
    if (!d->has_staged || seq != d->staged_seq) {
        ack_set(d, COMMIT, seq, newer16(seq, d->latest) ? NOT_STAGED : STALE);
        return;
    }
    reason = commit_refusal(d, seq, get16(data + 2), get32(data + 4), &item);
    if (reason == OK) {
        note(&d->commit_pending, data);
        d->pending.seq = seq;
        memcpy(d->pending.gains.k, d->staged, sizeof d->staged);
        return;
    }
    forget_staged(d);
    note(&d->commit_refused, data);
    make_ack(d, d->refusal, COMMIT, seq, reason, d->latest, item);
    send(d, ACK, 8, d->refusal, true);
}

static void on_abort(rt_device *d, const uint8_t *data)
{
    uint16_t seq = get16(data);
    if (seq == d->running.seq) {
        ack_set(d, ABORT, seq, ALREADY_RUNNING);
        return;
    }
    if (!(d->has_staged && seq == d->staged_seq) && !newer16(seq, d->latest)) {
        ack_set(d, ABORT, seq, STALE);
        return;
    }
    d->commit_pending.there = false;
    forget_staged(d);
    d->latest = seq;
    renew_challenge(d); /* numbers come round again; a code for this one must not */
    ack_set(d, ABORT, seq, OK);
}

static void on_confirm(rt_device *d, const uint8_t *data)
{
    uint16_t seq = get16(data);
    unsigned reason = get16(data + 2) != d->owner ? NOT_OWNER : seq != d->running.seq ? STALE : OK;
    if (reason == OK)
        d->confirmed = d->running;
    ack_set(d, CONFIRM, seq, reason);
}

/* Keep the running set, in the place that is not the newest, so that the other one stays whole meanwhile. */
static void keep_running(rt_device *d)
{
    uint32_t generation[RT_SLOTS];
    int older = 0;
    rt_slot *slot;
    for (int i = 0; i < RT_SLOTS; i++)
        generation[i] = is_whole(&d->slots[i]) ? d->slots[i].generation : 0;
    if (generation[1] < generation[0])
        older = 1;
    slot = &d->storing;
    memset(slot, 0, sizeof *slot);
    slot->generation = generation[1 - older] + 1;
    slot->content = d->running;
    slot->crc = slot_crc(slot);
    memset(&d->slots[older], 0, sizeof d->slots[older]); /* nobody knows what stands there meanwhile */
    d->storing_place = (int8_t)older;
    d->port.keep(d->port.context, older, slot);
}

void rt_stored(rt_device *d, bool is_there)
{
    if (d->storing_place < 0)
        return;
    if (is_there)
        d->slots[d->storing_place] = d->storing;
    d->storing_place = -1;
    ack_set(d, STORE, d->storing.content.seq, is_there ? OK : NOT_STORED);
}

static void on_store(rt_device *d, const uint8_t *data)
{
    uint16_t seq = get16(data);
    unsigned reason = OK;
    if (d->owner == NOBODY || data[6] != (d->owner & 255u))
        reason = NOT_OWNER;
    else if (get32(data + 2) != STORE_KEY)
        reason = WRONG_KEY;
    else if (seq != d->running.seq)
        reason = STALE;
    else if (on_trial(d))
        reason = NOT_CONFIRMED;
    else if (!is_stored(d)) {
        if (d->storing_place < 0) {
            keep_running(d);
            return; /* rt_stored answers */
        }
        if (is_equal(&d->storing.content, &d->running))
            return;
        reason = BUSY;
    }
    ack_set(d, STORE, seq, reason);
}

static void on_auth(rt_device *d, const uint8_t *data)
{
    unsigned part = data[0] & 15, place = d->half_next[part];
    d->halves[part][place] = get48(data + 1);
    d->half_seq[part][place] = data[0] >> 4;
    d->half_next[part] = (uint8_t)((place + 1) % RT_HALVES_KEPT);
    if (d->half_count[part] < RT_HALVES_KEPT)
        d->half_count[part]++;
}

/* Run the committed set from now on, or the confirmed one when the trial time is over; whether another set runs. Both
   wait for a reading that is a number: without one nobody can tell what keeps co where it is. */
static bool swap(rt_device *d, bool is_number)
{
    if (d->commit_pending.there && is_number) {
        d->running = d->pending;
        d->commit_of_running = d->commit_pending;
        d->commit_pending.there = false;
        d->trial_left = d->settings.trial_samples;
        forget_staged(d);
        ack_set(d, COMMIT, d->running.seq, OK);
        return true;
    }
    if (d->trial_left == 1 && !is_number)
        return false;
    if (d->trial_left && on_trial(d) && --d->trial_left == 0) {
        uint16_t seq = d->running.seq;
        d->running = d->confirmed;
        d->commit_of_running.there = false;
        ack_set(d, CONFIRM, seq, REVERTED);
        return true;
    }
    return false;
}

/* ---- the lease */

static unsigned lease_refusal(const rt_device *d, const uint8_t *data)
{
    uint16_t owner = get16(data), stamp = get16(data + 2);
    uint32_t before = d->sample < STAMP_SAMPLES ? 0 : d->sample - STAMP_SAMPLES;
    if (stamp != lease_stamp(d->epoch, d->sample) && stamp != lease_stamp(d->epoch, before))
        return STALE;
    if (d->owner != NOBODY && d->owner != owner)
        return NOT_OWNER;
    if (!d->lease.there || get16(d->lease.data) != owner || is_same(&d->lease, data))
        return OK;
    return newer8(data[6], d->lease.data[6]) ? OK : STALE;
}

static void on_lease(rt_device *d, const uint8_t *data)
{
    uint16_t owner = get16(data), samples = get16(data + 4), before = d->owner;
    unsigned reason = lease_refusal(d, data);
    if (reason == OK && !is_same(&d->lease, data)) {
        note(&d->lease, data);
        d->lease_left = samples < d->settings.lease_longest_samples ? samples : d->settings.lease_longest_samples;
        d->owner = d->lease_left ? owner : NOBODY;
    }
    if (d->owner != before)
        drop_staged(d);
    ack(d, LEASE, owner, reason, d->owner, 0);
}

static void tick_lease(rt_device *d)
{
    if (d->owner != NOBODY && --d->lease_left == 0) {
        d->owner = NOBODY;
        drop_staged(d);
    }
}

/* ---- setpoint, mode, load */

static void on_command(rt_device *d, unsigned kind, const uint8_t *data)
{
    rt_heard *last = &d->commands[kind - SETPOINT];
    uint8_t counter = data[0];
    bool is_auto = data[1] == 1, again = is_same(last, data), inside = true;
    float value = get_float(data + 1);
    if (kind == MODE)
        value = (float)((int32_t)((uint32_t)data[2] << 8 | (uint32_t)data[3] << 16 | (uint32_t)data[4] << 24) / 256)
                / CO_STEPS;
    if (get16(data + 5) != d->owner) {
        ack(d, kind, counter, NOT_OWNER, counter, 0);
        return;
    }
    if (last->there && !again && !newer8(counter, last->data[0])) {
        ack(d, kind, counter, STALE, last->data[0], 0);
        return;
    }
    if (kind == SETPOINT)
        inside = value >= d->settings.sp_min && value <= d->settings.sp_max;
    if (kind == MODE)
        inside = is_auto || (value >= d->settings.co_min && value <= d->settings.co_max);
    if (inside && !again) {
        note(last, data);
        if (kind == SETPOINT) {
            d->sp = value;
            d->is_sp_told = true;
        } else if (kind == LOAD)
            d->load = value;
        else {
            d->is_auto = is_auto;
            d->manual_co = value;
        }
    }
    ack(d, kind, counter, inside ? OK : OUT_OF_RANGE, counter, 0);
}

/* ---- what the device tells */

static void tell_life(rt_device *d)
{
    uint8_t data[8];
    unsigned flags = 0;
    flags |= d->is_auto ? FLAG_AUTO : 0;
    flags |= d->has_staged ? FLAG_STAGED : 0;
    flags |= is_stored(d) ? FLAG_STORED : 0;
    flags |= on_trial(d) ? FLAG_TRIAL : 0;
    flags |= d->owner != NOBODY ? FLAG_OWNED : 0;
    flags |= d->wrong_codes ? FLAG_WRONG_CODE : 0;
    flags |= d->is_blind ? FLAG_BLIND : 0;
    flags |= d->is_fault ? FLAG_FAULT : 0;
    put32(data, d->sample);
    put16(data + 4, d->epoch);
    data[6] = (uint8_t)flags;
    send(d, HEARTBEAT, 8, data, true);
    put16(data, d->running.seq);
    put16(data + 2, d->latest);
    data[4] = (uint8_t)d->refused;
    put16(data + 5, d->owner);
    send(d, STATUS, 8, data, true);
}

static void tell_sample(rt_device *d)
{
    uint8_t pv[8], sp[8], said[18];
    uint8_t counter = (uint8_t)d->sample, running = d->running.seq & 31, mode = d->is_auto ? 1 : 0;
    float shown = clip(d->pv, -PV_MAX, PV_MAX);
    int32_t co = (int32_t)lrintf(d->co * CO_STEPS);
    pv[0] = sp[0] = said[1] = said[10] = counter;
    put_float(pv + 1, shown);
    pv[5] = (uint8_t)co;
    put16(pv + 6, (uint32_t)co >> 8);
    put_float(sp + 1, d->sp);
    sp[5] = (uint8_t)(mode | (d->law.limited & 3) << 1 | running << 3);
    said[0] = d->settings.node;
    put_float(said + 2, shown);
    put32(said + 6, (uint32_t)co);
    put_float(said + 11, d->sp);
    said[15] = mode;
    said[16] = (uint8_t)d->law.limited;
    said[17] = running;
    put16(sp + 6, crc16(said, sizeof said));
    send(d, TELEMETRY_PV, 8, pv, false);
    send(d, TELEMETRY_SP, 8, sp, false);
}

static void tell_identity(rt_device *d)
{
    uint8_t data[8];
    data[0] = RT_PROTOCOL_VERSION;
    put16(data + 1, RT_LAYOUT_HASH);
    put_float(data + 3, d->settings.sample_time_s);
    send(d, IDENTITY, 8, data, true);
    tell_life(d);
}

static void tell_challenge(rt_device *d, uint16_t token)
{
    uint8_t data[8];
    data[0] = (uint8_t)((token & 127) | (d->settings.key ? 128 : 0));
    put32(data + 1, (uint32_t)d->nonce);
    put16(data + 5, (uint32_t)(d->nonce >> 32));
    send(d, CHALLENGE, 8, data, true);
}

/* A page as it stands: the gains that are there, and its end. What no PID can run may be staged: it has CRC 0. */
static void tell_page(rt_device *d, unsigned page, uint16_t token)
{
    uint8_t data[8], said[2], head = (uint8_t)(page | (token & 15u) << 4);
    rt_set set = page == PAGE_RUNNING ? d->running : stored(d);
    unsigned items = ALL_ITEMS;
    uint32_t crc = 0;
    if (page == PAGE_STAGED) {
        set.seq = d->has_staged ? d->staged_seq : d->latest;
        items = d->staged_items;
        memcpy(set.gains.k, d->staged, sizeof d->staged);
    }
    for (unsigned i = 0; i < RT_GAINS; i++)
        if (items >> i & 1) {
            data[0] = (uint8_t)(head | i << 2);
            put_float(data + 1, set.gains.k[i]);
            put16(data + 5, set.seq);
            send(d, ITEM, 8, data, true);
        }
    put16(said, token);
    if (items == ALL_ITEMS && is_pid(set.gains.k))
        crc = rt_crc32(set_crc(d, set.seq, set.gains.k), said, sizeof said);
    data[0] = (uint8_t)(head | (items == ALL_ITEMS ? 4 : 0));
    put16(data + 1, set.seq);
    put32(data + 3, crc);
    send(d, PAGE, 8, data, true);
}

static void on_read(rt_device *d, const uint8_t *data)
{
    uint16_t token = get16(data + 1);
    if (data[0] == PAGE_IDENTITY)
        tell_identity(d);
    else if (data[0] == PAGE_CHALLENGE)
        tell_challenge(d, token);
    else
        tell_page(d, data[0], token);
}

/* ---- from outside */

/* The first setting that is outside its range; NULL: none. A comparison with no number is false, so each asks for good. */
static const char *bad_setting(const rt_settings *s, const rt_port *port)
{
    bool is_in_box = true;
    for (int i = 0; i < RT_GAINS; i++)
        is_in_box = is_in_box && s->gain_max[i] > 0.0f && is_within(s->gain_max[i], VALUE_MAX);
    if (s->node < 1 || s->node > NODE_MAX)
        return "node";
    if (!(s->sample_time_s >= SAMPLE_TIME_MIN_S && s->sample_time_s <= SAMPLE_TIME_MAX_S))
        return "sample_time_s";
    if (!is_pid(s->gains.k) || !is_within(s->gains.k[0], VALUE_MAX) || !is_within(s->gains.k[1], VALUE_MAX)
        || !is_within(s->gains.k[2], VALUE_MAX))
        return "gains";
    if (!is_in_box)
        return "gain_max";
    if (!(s->ratio_max >= 1.0f && s->ratio_max <= VALUE_MAX))
        return "ratio_max";
    if (s->direction < -1 || s->direction > 1)
        return "direction";
    if (!(s->sp_min < s->sp_max && is_within(s->sp_min, SP_MAX) && is_within(s->sp_max, SP_MAX)))
        return "sp_min, sp_max";
    if (!(s->co_min < s->co_max && s->co_min * CO_STEPS >= (float)CO_LOW && s->co_max * CO_STEPS <= (float)CO_HIGH))
        return "co_min, co_max";
    if (!(s->co_rate_per_s >= 0.0f && s->co_rate_per_s <= VALUE_MAX))
        return "co_rate_per_s";
    if (!is_within(s->co_fault, VALUE_MAX))
        return "co_fault";
    if (!(s->b >= 0.0f && s->b <= 1.0f))
        return "b";
    if (!(s->tau_f_s >= 0.0f && s->tau_f_s <= VALUE_MAX))
        return "tau_f_s";
    if (s->heartbeat_samples < 1 || s->heartbeat_samples > HEARTBEAT_SAMPLES_MAX)
        return "heartbeat_samples";
    if (s->lease_longest_samples < 1)
        return "lease_longest_samples";
    if (s->key && s->key_length < KEY_LENGTH_MIN)
        return "key_length";
    return s->key && !port->random ? "random" : 0;
}

/* The law begins at rest at this pv, with the output in force. */
static void begin(rt_device *d, float pv)
{
    if (!d->is_sp_told)
        d->sp = clip(pv, d->settings.sp_min, d->settings.sp_max);
    d->pv = pv;
    start_law(d, pv, d->co);
}

const char *rt_boot(rt_device *d, const rt_settings *settings, const rt_port *port, uint16_t epoch,
                    const rt_slot slots[RT_SLOTS], float pv, float co, float sp)
{
    const char *bad = bad_setting(settings, port);
    memset(d, 0, sizeof *d);
    d->settings = *settings;
    d->port = *port;
    d->epoch = epoch;
    memcpy(d->slots, slots, sizeof d->slots);
    d->storing_place = -1;
    d->co = isfinite(co) ? co : isfinite(settings->co_fault) ? settings->co_fault : 0.0f;
    if (bad)
        return bad;
    d->is_ready = true;
    d->running = d->confirmed = stored(d);
    d->latest = d->running.seq;
    d->is_auto = true;
    d->is_sp_told = is_within(sp, SP_MAX);
    if (d->is_sp_told)
        d->sp = clip(sp, settings->sp_min, settings->sp_max);
    d->has_begun = is_within(pv, PV_MAX);
    d->is_blind = !d->has_begun;
    begin(d, d->has_begun ? pv : clip(d->sp, settings->sp_min, settings->sp_max));
    d->co = d->manual_co = d->law.co;
    renew_challenge(d);
    return 0;
}

void rt_fault(rt_device *d, bool is_fault)
{
    d->is_fault = is_fault;
}

/* Whether the numbers of a host's frame are in the ranges of the DBC. */
static bool is_in_range(unsigned command, const uint8_t *data)
{
    int32_t co = (int32_t)((uint32_t)data[2] << 8 | (uint32_t)data[3] << 16 | (uint32_t)data[4] << 24) / 256;
    bool owned = get16(data + 5) != NOBODY;
    switch (command) {
    case LEASE:
        return get16(data) != NOBODY;
    case READ:
        return data[0] <= PAGE_CHALLENGE;
    case STAGE:
        return (data[0] & 3) < RT_GAINS && is_within(get_float(data + 1), VALUE_MAX);
    case CONFIRM:
        return get16(data + 2) != NOBODY;
    case SETPOINT:
        return is_within(get_float(data + 1), SP_MAX) && owned;
    case MODE:
        return data[1] <= 1 && co >= CO_LOW && co <= CO_HIGH && owned;
    case LOAD:
        return is_within(get_float(data + 1), LOAD_MAX) && owned;
    case AUTH:
        return (data[0] & 15) <= 1;
    default:
        return true;
    }
}

static void answer(rt_device *d, unsigned command, const uint8_t *data)
{
    switch (command) {
    case LEASE: on_lease(d, data); break;
    case READ: on_read(d, data); break;
    case ABORT: on_abort(d, data); break;
    case STAGE: on_stage(d, data); break;
    case COMMIT: on_commit(d, data); break;
    case STORE: on_store(d, data); break;
    case CONFIRM: on_confirm(d, data); break;
    case AUTH: on_auth(d, data); break;
    default: on_command(d, command, data); break;
    }
}

void rt_receive(rt_device *d, const rt_frame *frame)
{
    static const uint8_t lengths[AUTH + 1] = {0, 8, 4, 3, 8, 8, 8, 5, 8, 8, 8, 8};
    unsigned command = frame->id & 31u;
    uint8_t data[8] = {0};
    bool good;
    if (!d->is_ready || frame->id >> COMMAND_BITS != d->settings.node)
        return;
    good = !frame->odd && command >= LEASE && command <= AUTH && frame->length == lengths[command];
    if (good) {
        memcpy(data, frame->data, frame->length);
        good = command == COMMIT || data[frame->length - 1] == frame_crc(frame->id, data, frame->length - 1u);
    }
    if (good && is_in_range(command, data))
        answer(d, command, data);
    else
        d->refused++;
}

/* The output of this sample: a fault before manual before automatic, which waits for a number. */
static void regulate(rt_device *d, bool is_number, float dt)
{
    float pv = is_number ? d->pv : d->law.pv;
    if (d->is_fault)
        track_law(d, d->settings.co_fault, 0.0f, pv, dt);
    else if (!d->is_auto)
        track_law(d, d->manual_co, d->settings.co_rate_per_s * dt, pv, dt);
    else if (is_number)
        step_law(d, pv, dt);
    d->co = d->law.co;
}

float rt_sample(rt_device *d, float pv, float dt)
{
    rt_gains old = d->running.gains;
    bool is_number = is_within(pv, PV_MAX);
    if (!d->is_ready || !(dt > 0.0f && isfinite(dt)))
        return d->co;
    d->is_blind = !is_number;
    if (is_number && !d->has_begun)
        begin(d, pv);
    if (is_number) {
        d->has_begun = true;
        d->pv = pv;
    }
    if (swap(d, is_number))
        change_law(d, &old, pv, dt);
    regulate(d, is_number, dt);
    d->sample++;
    tick_lease(d);
    tell_sample(d);
    if (d->sample % d->settings.heartbeat_samples == 0 || d->sample == 1)
        tell_life(d);
    if (d->port.alive)
        d->port.alive(d->port.context);
    return d->co;
}
