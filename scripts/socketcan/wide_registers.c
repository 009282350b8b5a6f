/* ptrace for a user-mode Linux that is older than the processor: registers wider than it knows are completed.
 *
 * User-mode Linux 6.1 keeps a fixed space for a process's floating point registers. A kernel on a processor with wider
 * ones (AMX) gives that much of them, but takes only the whole set back, and the guest panics at its first process
 * ("ptrace set fp regs failed, errno = 14"). So a short set is laid over the process's present one before it goes back.
 *
 *     cc -shared -fPIC -O2 -o wide_registers.so wide_registers.c -ldl;  LD_PRELOAD=./wide_registers.so linux.uml ...
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/types.h>
#include <sys/uio.h>

#ifndef NT_X86_XSTATE
#define NT_X86_XSTATE 0x202
#endif
enum { WIDEST = 65536 };

typedef long (*Ptrace)(int, pid_t, void *, void *);

long ptrace(enum __ptrace_request request, ...)
{
    static Ptrace next;
    static unsigned char whole[WIDEST];
    va_list given;
    va_start(given, request);
    pid_t pid = va_arg(given, pid_t);
    void *address = va_arg(given, void *);
    void *data = va_arg(given, void *);
    va_end(given);
    if (!next)
        next = (Ptrace)dlsym(RTLD_NEXT, "ptrace");
    if ((int)request == PTRACE_SETREGSET && (long)address == NT_X86_XSTATE) {
        struct iovec *part = data, present = {whole, WIDEST};
        if (next(PTRACE_GETREGSET, pid, address, &present) == 0 && present.iov_len > part->iov_len) {
            memcpy(whole, part->iov_base, part->iov_len);
            return next(request, pid, address, &present);
        }
    }
    return next((int)request, pid, address, data);
}
