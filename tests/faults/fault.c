// Runs a program and kills it, or makes one of its calls fail, at the N-th call to the file system
// that touches a folder. Every thread is followed, and calls that bypass the C library are seen too
// (seccomp hands them to this tracer). Linux on x86-64.
//
//   fault DIR LOG count            PROGRAM ARGS...   count, and list the calls in LOG: number,
//                                                    name, "space" where it needs some, path
//   fault DIR LOG kill N           PROGRAM ARGS...   SIGKILL before the N-th call
//   fault DIR LOG full N           PROGRAM ARGS...   no space left from the N-th call on
//   fault DIR LOG read N           PROGRAM ARGS...   the N-th reading call fails (EIO)
//   fault DIR LOG count-reads      PROGRAM ARGS...   as `count`, of reading calls
//
// The exit code is the program's; 137 after a kill; 125 where tracing is not possible.
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <signal.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <sys/user.h>
#include <sys/wait.h>
#include <unistd.h>

#ifndef __x86_64__
int main(void) { return 125; }
#else

enum { PATH = 1, AT = 2, FD = 4, PATH2 = 8, AT2 = 16, READS = 32, SPACE = 64 };

// Which arguments of a call name files, and whether it needs space or only reads. `open` with
// O_CREAT changes, without it reads; that is told apart when it is called.
static const struct { long number; const char *name; int kind; } CALLS[] = {
    {SYS_open, "open", PATH}, {SYS_creat, "creat", PATH | SPACE}, {SYS_openat, "openat", AT},
    {SYS_write, "write", FD | SPACE}, {SYS_pwrite64, "pwrite", FD | SPACE},
    {SYS_writev, "writev", FD | SPACE}, {SYS_ftruncate, "ftruncate", FD | SPACE},
    {SYS_fallocate, "fallocate", FD | SPACE}, {SYS_fsync, "fsync", FD}, {SYS_fdatasync, "fdatasync", FD},
    {SYS_rename, "rename", PATH | PATH2}, {SYS_renameat, "renameat", AT | AT2},
    {SYS_renameat2, "renameat2", AT | AT2}, {SYS_link, "link", PATH | PATH2 | SPACE},
    {SYS_linkat, "linkat", AT | AT2 | SPACE}, {SYS_unlink, "unlink", PATH}, {SYS_unlinkat, "unlinkat", AT},
    {SYS_rmdir, "rmdir", PATH}, {SYS_mkdir, "mkdir", PATH | SPACE}, {SYS_mkdirat, "mkdirat", AT | SPACE},
    {SYS_chmod, "chmod", PATH}, {SYS_fchmod, "fchmod", FD}, {SYS_fchmodat, "fchmodat", AT},
    {SYS_read, "read", FD | READS}, {SYS_pread64, "pread", FD | READS},
    {SYS_getdents64, "getdents", FD | READS},
};
#define COUNT (sizeof CALLS / sizeof *CALLS)

static char folder[4096];

static void link_of(pid_t pid, const char *what, char *path) {
    char name[64];
    snprintf(name, sizeof name, "/proc/%d/%s", pid, what);
    ssize_t length = readlink(name, path, 4095);
    path[length < 0 ? 0 : length] = 0;
}

// The path that a call names: text at `address`, below the folder of `fd`.
static void path_at(pid_t pid, int fd, unsigned long address, char *path) {
    char text[4096] = "", base[4096] = "", what[32];
    for (size_t done = 0; done < sizeof text - 1; done += 64) {
        struct iovec here = {text + done, 64}, there = {(void *)(address + done), 64};
        ssize_t got = process_vm_readv(pid, &here, 1, &there, 1, 0);
        if (got <= 0) { // the page may end there
            while (done < sizeof text - 1) {
                here = (struct iovec){text + done, 1}, there = (struct iovec){(void *)(address + done), 1};
                if (process_vm_readv(pid, &here, 1, &there, 1, 0) != 1 || !text[done]) break;
                done++;
            }
            text[done] = 0;
            break;
        }
        if (memchr(text + done, 0, (size_t)got)) break;
    }
    if (text[0] == '/') { strcpy(path, text); return; }
    if (fd == AT_FDCWD) strcpy(what, "cwd"); else snprintf(what, sizeof what, "fd/%d", fd);
    link_of(pid, what, base);
    if (snprintf(path, 4096, "%s/%s", base, text) < 0) path[0] = 0;
}

static int inside(const char *path) {
    size_t n = strlen(folder);
    return strncmp(path, folder, n) == 0 && (path[n] == 0 || path[n] == '/');
}

// Whether the call touches the folder; its path, and its kind with READS set where it only reads.
static int looked_at(pid_t pid, const struct user_regs_struct *r, size_t call, char *path, int *kind) {
    char other[4096], what[32];
    *kind = CALLS[call].kind;
    if (CALLS[call].number == SYS_open || CALLS[call].number == SYS_openat) {
        unsigned long flags = CALLS[call].number == SYS_open ? r->rsi : r->rdx;
        *kind |= flags & (O_CREAT | O_TRUNC) ? SPACE : READS;
    }
    if (*kind & FD) {
        snprintf(what, sizeof what, "fd/%d", (int)r->rdi);
        link_of(pid, what, path);
        return inside(path);
    }
    if (*kind & PATH) path_at(pid, AT_FDCWD, r->rdi, path); else path_at(pid, (int)r->rdi, r->rsi, path);
    if (inside(path)) return 1;
    if (*kind & PATH2) path_at(pid, AT_FDCWD, r->rsi, other);
    else if (*kind & AT2) path_at(pid, (int)r->rdx, r->r10, other);
    else return 0;
    return inside(other);
}

static void start(char **program) {
    struct sock_filter filter[COUNT + 3];
    filter[0] = (struct sock_filter)BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, nr));
    for (size_t i = 0; i < COUNT; i++)
        filter[i + 1] = (struct sock_filter)BPF_JUMP(
            BPF_JMP | BPF_JEQ | BPF_K, (unsigned)CALLS[i].number, (unsigned char)(COUNT - i), 0);
    filter[COUNT + 1] = (struct sock_filter)BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW);
    filter[COUNT + 2] = (struct sock_filter)BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_TRACE);
    struct sock_fprog all = {COUNT + 3, filter};
    if (ptrace(PTRACE_TRACEME, 0, 0, 0) || raise(SIGSTOP) || prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) ||
        prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &all))
        _exit(125);
    execvp(program[0], program);
    _exit(125);
}

int main(int argc, char **argv) {
    if (argc < 5 || !realpath(argv[1], folder)) return 125;
    const char *mode = argv[3];
    int counts = strncmp(mode, "count", 5) == 0, reads = !strcmp(mode, "read") || !strcmp(mode, "count-reads");
    long wanted = counts ? 0 : atol(argv[4]), seen = 0;
    FILE *log = fopen(argv[2], "w");
    pid_t child = fork(), pid;
    if (child == 0) start(argv + (counts ? 4 : 5));
    int status, code = 125;
    if (waitpid(child, &status, 0) != child || !WIFSTOPPED(status)) return 125;
    long options = PTRACE_O_TRACESECCOMP | PTRACE_O_TRACECLONE | PTRACE_O_TRACEFORK | PTRACE_O_TRACEVFORK |
                   PTRACE_O_TRACEEXEC | PTRACE_O_EXITKILL;
    if (!log || ptrace(PTRACE_SETOPTIONS, child, 0, options)) { kill(child, SIGKILL); return 125; }
    ptrace(PTRACE_CONT, child, 0, 0);
    while ((pid = waitpid(-1, &status, __WALL)) > 0 || errno == EINTR) {
        if (WIFEXITED(status) || WIFSIGNALED(status)) {
            if (pid == child) code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
            continue;
        }
        int signal = WSTOPSIG(status), event = status >> 16, kind;
        struct user_regs_struct r;
        char path[8192];
        if (event == PTRACE_EVENT_SECCOMP && !ptrace(PTRACE_GETREGS, pid, 0, &r)) {
            for (size_t i = 0; i < COUNT; i++) {
                if ((long)r.orig_rax != CALLS[i].number) continue;
                if (!looked_at(pid, &r, i, path, &kind) || !!(kind & READS) != reads) break;
                seen++;
                fprintf(log, "%ld %s %s %s\n", seen, CALLS[i].name, kind & SPACE ? "space" : "-", path);
                if (!counts && seen == wanted && !strcmp(mode, "kill")) {
                    fclose(log);
                    kill(child, SIGKILL);
                    // Its threads must be waited for too; its children are killed with this tracer.
                    while ((pid = waitpid(-1, &status, __WALL)) > 0 || errno == EINTR)
                        if (pid == child && !WIFSTOPPED(status)) break;
                    return 137;
                }
                int full = !strcmp(mode, "full") && seen >= wanted && kind & SPACE;
                if (full || (!strcmp(mode, "read") && seen == wanted)) {
                    r.orig_rax = (unsigned long)-1;
                    r.rax = (unsigned long)-(full ? ENOSPC : EIO);
                    ptrace(PTRACE_SETREGS, pid, 0, &r);
                }
                break;
            }
        }
        int passed_on = event || signal == SIGTRAP || signal == SIGSTOP ? 0 : signal;
        ptrace(PTRACE_CONT, pid, 0, passed_on);
    }
    fclose(log);
    return code;
}
#endif
