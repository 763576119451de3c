// Preloaded (LD_PRELOAD) into the program: lists the places of floating-point operations without a
// sensible result (0/0, inf - inf, inf * 0, square roots below zero) when it ends.
//
//   cc -O1 -shared -fPIC -o fpe.so fpe.c -lm && LD_PRELOAD=./fpe.so FPE_LOG=FILE sat-recon ...
//
// Each line of the file is: the offset in the program, "scalar" or "packed", how often. Packed
// operations of compiled code work on unused lanes, too: what they yield there is thrown away, so
// only scalar ones are findings. Conversions to integers and comparisons raise the same exception
// with NaN where Rust defines the result (saturating casts, f32::max); they are left out. Each
// operation is done untrapped, one step, and the program goes on. Linux on x86-64.
#define _GNU_SOURCE
#include <fenv.h>
#include <link.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <ucontext.h>

enum { TRAP_FLAG = 0x100, MASK = FE_INVALID << 7, PLACES = 4096 };

static struct { unsigned long place; int is_scalar; long count; } seen[PLACES];

// Whether an instruction converts or compares: 0F 2C/2D/5B/E6/78-7A (conversions), 2E/2F/C2
// (comparisons), 5D/5F (minimum, maximum), behind prefixes and REX, VEX or EVEX; whether its
// operation is on single numbers.
static int is_defined(const unsigned char *at, int *is_scalar) {
    *is_scalar = 0;
    for (; *at == 0x66 || *at == 0xf2 || *at == 0xf3 || (*at & 0xf0) == 0x40; at++)
        if (*at == 0xf2 || *at == 0xf3) *is_scalar = 1;
    unsigned char code;
    if (at[0] == 0x0f) code = at[1];
    else if (at[0] == 0xc5) code = at[2], *is_scalar = (at[1] & 2) != 0;
    else if (at[0] == 0xc4) code = at[3], *is_scalar = (at[2] & 2) != 0;
    else if (at[0] == 0x62) code = at[4], *is_scalar = (at[2] & 2) != 0;
    else return 0;
    return code == 0x2c || code == 0x2d || code == 0x5b || code == 0xe6 || code == 0x2e || code == 0x2f ||
           code == 0xc2 || code == 0x5d || code == 0x5f || code == 0x78 || code == 0x79 || code == 0x7a;
}

static void trapped(int number, siginfo_t *info, void *context) {
    ucontext_t *c = context;
    unsigned long place = (unsigned long)c->uc_mcontext.gregs[REG_RIP];
    int is_scalar;
    if (!is_defined((const unsigned char *)place, &is_scalar)) {
        for (size_t k = place % PLACES, tried = 0; tried < PLACES; k = (k + 1) % PLACES, tried++) {
            unsigned long free = 0;
            if (__atomic_compare_exchange_n(&seen[k].place, &free, place, 0, __ATOMIC_SEQ_CST, __ATOMIC_SEQ_CST) || free == place) {
                seen[k].is_scalar = is_scalar;
                __atomic_add_fetch(&seen[k].count, 1, __ATOMIC_SEQ_CST);
                break;
            }
        }
    }
    c->uc_mcontext.fpregs->mxcsr |= MASK;
    c->uc_mcontext.gregs[REG_EFL] |= TRAP_FLAG;
    (void)number, (void)info;
}

static void stepped(int number, siginfo_t *info, void *context) {
    ucontext_t *c = context;
    c->uc_mcontext.gregs[REG_EFL] &= ~TRAP_FLAG;
    c->uc_mcontext.fpregs->mxcsr &= ~(MASK | FE_INVALID);
    (void)number, (void)info;
}

__attribute__((constructor)) static void arm(void) {
    struct sigaction action = {.sa_sigaction = trapped, .sa_flags = SA_SIGINFO | SA_NODEFER | SA_ONSTACK};
    sigaction(SIGFPE, &action, 0);
    action.sa_sigaction = stepped;
    sigaction(SIGTRAP, &action, 0);
    feenableexcept(FE_INVALID);
}

static int first_base(struct dl_phdr_info *info, size_t size, void *base) {
    *(unsigned long *)base = info->dlpi_addr;
    (void)size;
    return 1; // the program itself is listed first
}

__attribute__((destructor)) static void tell(void) {
    fedisableexcept(FE_INVALID);
    const char *path = getenv("FPE_LOG");
    FILE *log = path ? fopen(path, "w") : stderr;
    unsigned long base = 0;
    dl_iterate_phdr(first_base, &base);
    for (size_t k = 0; log && k < PLACES; k++)
        if (seen[k].place)
            fprintf(log, "%#lx %s %ld\n", seen[k].place - base, seen[k].is_scalar ? "scalar" : "packed", seen[k].count);
    if (log && path) fclose(log);
}
