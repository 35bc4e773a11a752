/* What a worker gives up before it loads other people's code: memory without end, processes, the network, and writing
 * anywhere but in a folder of its own. Landlock and seccomp as documented in the kernel's userspace-api; what a kernel
 * lacks is left out, and Python is told (confinement.py). */
#ifndef _GNU_SOURCE
#define _GNU_SOURCE
#endif
#include <errno.h>
#include <sys/resource.h>

#include "engine.h"

enum { LIMITS = 1, FILES = 2, NETWORK_RULES = 4, CALLS = 8 };

#if defined(__linux__) && (defined(__x86_64__) || defined(__aarch64__))
#include <fcntl.h>
#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <sched.h>
#include <stddef.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

/* Landlock's interface, which older headers lack. */
enum { CREATE_RULESET = 444, ADD_RULE, RESTRICT_SELF, VERSION = 1, RULE_PATH = 1 };
struct ruleset {
    uint64_t files, network, scoped;
};
struct __attribute__((packed)) path_rule {
    uint64_t allowed;
    int32_t parent;
};
#define WRITE_FILE (1ULL << 1)
#define TRUNCATE (1ULL << 14)
#define CHANGES_1 (WRITE_FILE | 0x1ff0ULL) /* remove and make entries of every kind */
#define REFER (1ULL << 13)

EXPORT int ab_landlock(void)
{
    const long version = syscall(CREATE_RULESET, NULL, 0, VERSION);
    return version < 0 ? 0 : (int)version;
}

static int allow(int rules, const char *path, uint64_t what)
{
    struct path_rule rule = {what, open(path, O_PATH | O_CLOEXEC)};
    if (rule.parent < 0) return -1;
    const long failed = syscall(ADD_RULE, rules, RULE_PATH, &rule, 0);
    close(rule.parent);
    return (int)failed;
}

static int restrict_files(const char *folder)
{
    const int version = ab_landlock();
    if (!version) return 0;
    struct ruleset all = {CHANGES_1, 0, 0};
    if (version >= 2) all.files |= REFER;
    if (version >= 3) all.files |= TRUNCATE;
    if (version >= 4) all.network = 3; /* TCP: bind, connect */
    if (version >= 6) all.scoped = 3; /* abstract sockets, signals */
    const size_t size = version >= 6 ? sizeof all : version >= 4 ? 16 : 8;
    const int rules = (int)syscall(CREATE_RULESET, &all, size, 0);
    if (rules < 0) return 0;
    const uint64_t writing = WRITE_FILE | (all.files & TRUNCATE);
    const int failed = allow(rules, folder, all.files) || allow(rules, "/dev/null", writing) ||
                       syscall(RESTRICT_SELF, rules, 0);
    close(rules);
    return failed ? 0 : version >= 4 ? FILES | NETWORK_RULES : FILES;
}

static const int refused[] = {
#ifdef __x86_64__ /* calls that newer processors no longer have */
    SYS_fork, SYS_vfork, SYS_chmod, SYS_chown, SYS_lchown,
#endif
    SYS_execve, SYS_execveat, SYS_socket, SYS_ptrace, SYS_process_vm_writev,
    SYS_process_vm_readv, SYS_rt_sigqueueinfo, SYS_rt_tgsigqueueinfo, SYS_pidfd_send_signal, SYS_mount, SYS_umount2,
    SYS_unshare, SYS_setns, SYS_chroot, SYS_pivot_root, SYS_reboot, SYS_kexec_load, SYS_init_module,
    SYS_finit_module, SYS_delete_module, SYS_bpf, SYS_perf_event_open, SYS_add_key, SYS_request_key, SYS_keyctl,
    SYS_swapon, SYS_swapoff, SYS_settimeofday, SYS_clock_settime, SYS_sethostname, SYS_setdomainname, SYS_setrlimit,
    SYS_setpriority, SYS_shmget, SYS_msgget, SYS_semget, SYS_memfd_create, SYS_fchmod, SYS_fchmodat,
    SYS_fchown, SYS_fchownat, SYS_setxattr, SYS_lsetxattr, SYS_fsetxattr, SYS_removexattr, SYS_lremovexattr,
    SYS_fremovexattr, 452 /* fchmodat2 */,
};

typedef struct {
    struct sock_filter code[4 * sizeof refused / sizeof *refused + 64];
    unsigned short size;
} Filter_;

static void emit(Filter_ *f, unsigned short op, unsigned int k, int yes, int no)
{
    f->code[f->size++] = (struct sock_filter){op, (unsigned char)yes, (unsigned char)no, k};
}

#define LOAD(field) emit(f, BPF_LD | BPF_W | BPF_ABS, (unsigned int)offsetof(struct seccomp_data, field), 0, 0)
#define ARGUMENT(i) emit(f, BPF_LD | BPF_W | BPF_ABS, (unsigned int)(offsetof(struct seccomp_data, args) + 8 * (i)), 0, 0)
#define IS(value, yes, no) emit(f, BPF_JMP | BPF_JEQ | BPF_K, (unsigned int)(value), yes, no)
#define REFUSE(error) emit(f, BPF_RET | BPF_K, SECCOMP_RET_ERRNO | (error), 0, 0)
#define ALLOW emit(f, BPF_RET | BPF_K, SECCOMP_RET_ALLOW, 0, 0)

static int restrict_calls(void)
{
    static Filter_ filter;
    Filter_ *f = &filter;
    f->size = 0;
    LOAD(arch);
#ifdef __x86_64__
    IS(AUDIT_ARCH_X86_64, 1, 0);
    REFUSE(EPERM);
    LOAD(nr);
    emit(f, BPF_JMP | BPF_JGE | BPF_K, 0x40000000, 0, 1); /* the x32 names of the same calls */
    REFUSE(EPERM);
#else
    IS(AUDIT_ARCH_AARCH64, 1, 0);
    REFUSE(EPERM);
    LOAD(nr);
#endif
    for (size_t i = 0; i < sizeof refused / sizeof *refused; i++) {
        IS(refused[i], 0, 1);
        REFUSE(EPERM);
    }
    IS(SYS_clone3, 1, 0); /* its arguments cannot be seen: the C library then uses clone */
    IS(SYS_io_uring_setup, 0, 1);
    REFUSE(ENOSYS);
    IS(SYS_clone, 0, 4);
    ARGUMENT(0);
    emit(f, BPF_JMP | BPF_JSET | BPF_K, CLONE_THREAD, 0, 1);
    ALLOW;
    REFUSE(EPERM);
    IS(SYS_kill, 2, 0); /* signals to itself only, for abort() */
    IS(SYS_tgkill, 1, 0);
    IS(SYS_tkill, 0, 4);
    ARGUMENT(0);
    IS(getpid(), 0, 1);
    ALLOW;
    REFUSE(EPERM);
    IS(SYS_mmap, 0, 5); /* shared memory of its own is not counted by the limit on memory */
    ARGUMENT(3);
    emit(f, BPF_ALU | BPF_AND | BPF_K, MAP_SHARED | MAP_ANONYMOUS, 0, 0);
    IS(MAP_SHARED | MAP_ANONYMOUS, 0, 1);
    REFUSE(ENOMEM);
    ALLOW;
    IS(SYS_prlimit64, 0, 3); /* limits may be read */
    ARGUMENT(2);
    IS(0, 1, 0);
    REFUSE(EPERM);
    ALLOW;
    const struct sock_fprog program = {f->size, f->code};
    /* without SPEC_ALLOW some kernels would slow all the model's arithmetic down */
    if (!syscall(SYS_seccomp, SECCOMP_SET_MODE_FILTER, SECCOMP_FILTER_FLAG_SPEC_ALLOW, &program)) return CALLS;
    return prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program, 0, 0) ? 0 : CALLS;
}

EXPORT int ab_seccomp(void) { return prctl(PR_GET_SECCOMP, 0, 0, 0, 0) >= 0; }

static int restrict_all(const char *folder)
{
    if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)) return 0;
    const int files = restrict_files(folder);
    return files | restrict_calls();
}
#else
EXPORT int ab_landlock(void) { return 0; }
EXPORT int ab_seccomp(void) { return 0; }
static int restrict_all(const char *folder) { return (void)folder, 0; }
#endif

static int limit(int what, int64_t value)
{
    struct rlimit now;
    if (value <= 0 || getrlimit(what, &now)) return value > 0;
    const rlim_t wanted = (rlim_t)value;
    if (now.rlim_max == RLIM_INFINITY || wanted < now.rlim_max) now.rlim_max = wanted;
    now.rlim_cur = now.rlim_max;
    return setrlimit(what, &now) != 0;
}

/* For the rest of this process's life; returns what was possible. Bytes of memory and of a file, 0 for any. */
EXPORT int ab_confine(const char *folder, int64_t memory, int64_t file)
{
    const struct rlimit none = {0, 0};
    const int failed = setrlimit(RLIMIT_CORE, &none) || limit(RLIMIT_DATA, memory) || limit(RLIMIT_FSIZE, file);
    return (failed ? 0 : LIMITS) | restrict_all(folder);
}
