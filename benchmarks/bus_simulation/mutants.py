"""The firmware with one thing wrong each: what an examination and the simulation must find.

Each is a name and one change of a text in drivers/firmware/retuner_device.c. The first group are single layers of the
protocol taken away; where another layer does the same work, only an examination that looks at each layer sees it.
"""

from typing import NamedTuple


class Mutant(NamedTuple):
    """One change: old stands there exactly once."""

    name: str
    old: str
    new: str


MUTANTS = tuple(
    Mutant(*texts)
    for texts in (
        # layers
        ("no checksum of frames", "good = command == COMMIT ||", "good = true ||"),
        (
            "no CRC of the commit",
            "if (crc != rt_crc32(set_crc(d, seq, d->staged), said, sizeof said))",
            "if (false && crc)",
        ),
        ("no CRC of the sample", "put16(sp + 6, crc16(said, sizeof said));", "put16(sp + 6, 0x1234);"),
        ("no token in the items", "head = (uint8_t)(page | (token & 15u) << 4);", "head = (uint8_t)page;"),
        ("no token in the CRC of a page", "put16(said, token);\n    if (items", "put16(said, 0);\n    if (items"),
        (
            "the stage stays when a number is older",
            "&& !newer16(seq, d->latest))\n        reason = STALE;",
            "&& false)\n        reason = STALE;",
        ),
        ("an abort burns nothing", "    d->latest = seq;\n    renew_challenge(d); /*", "    renew_challenge(d); /*"),
        (
            "an abort leaves the commit that waits",
            "    d->commit_pending.there = false;\n    forget_staged(d);\n    d->latest = seq;",
            "    forget_staged(d);\n    d->latest = seq;",
        ),
        (
            "counters are not compared",
            "if (last->there && !again && !newer8(counter, last->data[0])) {",
            "if (false) {",
        ),
        (
            "a lease is taken from its owner",
            "if (d->owner != NOBODY && d->owner != owner)\n        return NOT_OWNER;",
            "",
        ),
        ("a lease's counter is not compared", "return newer8(data[6], d->lease.data[6]) ? OK : STALE;", "return OK;"),
        ("a repeated lease is prolonged", "if (reason == OK && !is_same(&d->lease, data)) {", "if (reason == OK) {"),
        (
            "a lease's stamp is not compared",
            "if (stamp != lease_stamp(d->epoch, d->sample) && stamp != lease_stamp(d->epoch, before))",
            "if (stamp == before)",
        ),
        ("a lease never ends", "if (d->owner != NOBODY && --d->lease_left == 0) {", "if (false) {"),
        (
            "what is staged outlives its lease",
            "        d->owner = NOBODY;\n        drop_staged(d);",
            "        d->owner = NOBODY;",
        ),
        ("anybody stages", "if (d->owner == NOBODY || tag != (d->owner & 63u))", "if (tag > 63u)"),
        (
            "anybody confirms",
            "unsigned reason = get16(data + 2) != d->owner ? NOT_OWNER : seq",
            "unsigned reason = seq",
        ),
        ("anybody stores", "if (d->owner == NOBODY || data[6] != (d->owner & 255u))", "if (data[6] > 255u)"),
        ("anybody commands", "if (get16(data + 5) != d->owner) {", "if (false) {"),
        ("the challenge stays after a code", "        renew_challenge(d);\n        return OK;", "        return OK;"),
        ("the challenge stays after a fence", "    renew_challenge(d); /* numbers", "    /* numbers"),
        ("no code is asked for", "    if (!d->settings.key)\n        return OK;", "    return OK;"),
        ("half a code is enough", "if (low && high) {", "if (low || high) {"),
        (
            "a forged half displaces the right one",
            "for (unsigned i = 0; i < d->half_count[part]; i++)",
            "for (unsigned i = 0; i < 1; i++)",
        ),
        # conditions of a commit
        ("the base is not compared", "if (base != d->running.seq)\n        return WRONG_BASE;", ""),
        ("an incomplete page is taken", "if (d->staged_items != ALL_ITEMS) {", "if (!d->staged_items) {"),
        (
            "no largest gain, no sign",
            "if (fabsf(k) > s->gain_max[i] || k * (float)s->direction < 0.0f)",
            "if (fabsf(k) > VALUE_MAX)",
        ),
        ("all gains may be zero", "    if (!is_pid(d->staged))\n        return OUTSIDE_BOX;", ""),
        (
            "no largest ratio",
            "        if (old != 0.0f && d->staged[i] != 0.0f && !(ratio",
            "        if (false && !(ratio",
        ),
        (
            "the CRC does not cover the owner",
            "put16(said + 2, d->owner);\n    if (crc",
            "put16(said + 2, get16(said));\n    if (crc",
        ),
        (
            "the CRC does not cover the epoch",
            "    put16(said + 1, d->epoch);\n    put16(said + 3, seq);",
            "    put16(said + 1, 1);\n    put16(said + 3, seq);",
        ),
        (
            "a refused number may be staged again",
            "    forget_staged(d);\n    note(&d->commit_refused, data);",
            "    forget_staged(d);\n    d->latest = d->running.seq;\n    note(&d->commit_refused, data);",
        ),
        ("staged over a commit that waits", "    else if (d->commit_pending.there)\n        reason = BUSY;", ""),
        # the swap
        (
            "the set runs at once",
            "sizeof d->staged);\n        return;",
            "sizeof d->staged);\n        d->running.gains = d->pending.gains;\n        return;",
        ),
        (
            "one gain is left behind",
            "        d->running = d->pending;\n",
            "        d->pending.gains.k[2] = d->running.gains.k[2];\n        d->running = d->pending;\n",
        ),
        ("the swap jumps", "        d->law.integral += aim - after;", "        d->law.integral += 0.0f;"),
        ("a repeated commit is not known", "    if (is_same(&d->commit_of_running, data)) {", "    if (false) {"),
        (
            "the running set is aborted",
            "    if (seq == d->running.seq) {\n        ack_set(d, ABORT, seq, ALREADY_RUNNING);",
            "    if (false) {\n        ack_set(d, ABORT, seq, ALREADY_RUNNING);",
        ),
        # trial, store, boot
        ("never on trial", "        d->trial_left = d->settings.trial_samples;", "        d->confirmed = d->running;"),
        (
            "the trial does not end",
            "    if (d->trial_left && on_trial(d) && --d->trial_left == 0) {",
            "    if (false) {",
        ),
        ("stored on trial", "    else if (on_trial(d))\n        reason = NOT_CONFIRMED;", ""),
        ("stored without the key", "    else if (get32(data + 2) != STORE_KEY)\n        reason = WRONG_KEY;", ""),
        (
            "any number is confirmed",
            " seq != d->running.seq ? STALE : OK;\n    if (reason == OK)\n        d->confirmed",
            " OK;\n    if (reason == OK)\n        d->confirmed",
        ),
        (
            "any number is stored",
            "    else if (seq != d->running.seq)\n        reason = STALE;\n    else if (on_trial",
            "    else if (on_trial",
        ),
        (
            "a commit runs under another number than its stage",
            "    if (!d->has_staged || seq != d->staged_seq) {\n        ack_set(d, COMMIT",
            "    if (!d->has_staged) {\n        ack_set(d, COMMIT",
        ),
        ("a refused commit is judged anew", "    if (is_same(&d->commit_refused, data)) {", "    if (false) {"),
        (
            "a second commit takes the place of the one that waits",
            "    if (d->commit_pending.there) {\n        if (!is_same(&d->commit_pending, data))",
            "    if (d->commit_pending.there) {\n        if (false)",
        ),
        (
            "an abort asks for the lease",
            "    if (!(d->has_staged && seq == d->staged_seq) && !newer16(seq, d->latest)) {\n        ack_set(d, ABORT",
            "    if (d->owner == NOBODY || (!(d->has_staged && seq == d->staged_seq) && !newer16(seq, d->latest))) {\n"
            "        ack_set(d, ABORT",
        ),
        (
            "a lease's stamp of the last 64 samples is refused",
            "&& stamp != lease_stamp(d->epoch, before))",
            "&& before != 1)",
        ),
        (
            "a lease's stamp of long ago counts",
            "d->sample < STAMP_SAMPLES ? 0 : d->sample - STAMP_SAMPLES;",
            "d->sample < 2 * STAMP_SAMPLES ? 0 : d->sample - 2 * STAMP_SAMPLES;",
        ),
        # what is told
        (
            "one CRC of a sample in 40 is wrong",
            "put16(sp + 6, crc16(said, sizeof said));",
            "put16(sp + 6, crc16(said, sizeof said) ^ (d->sample % 40 == 39));",
        ),
        (
            "one checksum of a frame in 40 is wrong",
            "        data[length - 1] = frame_crc(frame.id, data, length - 1);",
            "        data[length - 1] = (uint8_t)(frame_crc(frame.id, data, length - 1) ^ (d->sample % 40 == 39));",
        ),
        ("the epoch is missing in answers", "| (uint32_t)(d->epoch & 0x1FFF) << 11;", ";"),
        ("refused frames are not counted", "        d->refused++;", "        return;"),
        ("a range is not checked", "    if (good && is_in_range(command, data))", "    if (good)"),
        (
            "the low bits of the running number are wrong",
            "running = d->running.seq & 31, mode",
            "running = d->confirmed.seq & 31, mode",
        ),
    )
)
"""All mutants of the device. A new epoch at every boot is the board's business: that is tried with the library."""

MUTANTS_OF_THE_STORE = tuple(
    Mutant(*texts)
    for texts in (
        (
            "the newest place is written over",
            "    if (generation[1] < generation[0])\n        older = 1;",
            "    if (generation[1] > generation[0])\n        older = 1;",
        ),
        (
            "torn places are run",
            "    return slot->generation > 0 && slot->crc == slot_crc(slot);",
            "    return slot->generation > 0;",
        ),
    )
)
"""What nobody sees from outside before power fails in the middle of a store."""
