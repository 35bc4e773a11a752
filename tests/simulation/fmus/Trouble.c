/* x' = -x, and every kind of misbehaviour, chosen by the parameter `mode`. */
#include "skeleton.h"
#include <fcntl.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/wait.h>
enum { FINE, CRASH, HANG, FAIL, REJECT, FLOOD, NOT_A_NUMBER, REFUSE_START, EVENTS_FOREVER, GONE, FATALLY, STIFFEN, BLOW_UP, LEAK,
       PRINT_FOREVER, ALLOCATE, ALLOCATE_SHARED, FORK, EXECUTE, WRITE_OUTSIDE, CHANGE_MODE, FILL_FILE, CONNECT,
       SIGNAL_PARENT, SAY_DONE };
static int flooded;
/* What should be refused: not 0 where it was not. */
static int misbehave(Model *m)
{
    char path[600];
    int fd = -1, got_through = 0;
    switch ((int)m->r[MODE]) {
    case PRINT_FOREVER:
        for (;;) printf("flood\n"), fflush(stdout);
    case ALLOCATE:
        for (;;) memset(m->callbacks->allocate(1 << 20, 1), 1, 1 << 20);
    case ALLOCATE_SHARED:
        return mmap(NULL, 1 << 20, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0) != MAP_FAILED;
    case FORK: {
        const pid_t child = fork();
        if (child == 0) sleep(3), _exit(0);
        return child > 0;
    }
    case EXECUTE: {
        const int status = system("true");
        return status != -1 && WIFEXITED(status) && WEXITSTATUS(status) == 0;
    }
    case WRITE_OUTSIDE:
        for (int i = 0; i < 3; i++) {
            if (i == 0) snprintf(path, sizeof path, "%s/evil", m->resources);
            if (i == 1) snprintf(path, sizeof path, "../evil");
            if (i == 2) snprintf(path, sizeof path, "/dev/shm/aero-bayes-evil");
            fd = open(path, O_WRONLY | O_CREAT, 0600);
            got_through |= fd >= 0;
            if (fd >= 0) close(fd), unlink(path);
        }
        fd = open("mine", O_WRONLY | O_CREAT, 0600); /* its own folder is its own */
        if (fd < 0 || write(fd, "x", 1) != 1 || close(fd) || unlink("mine")) got_through = 1;
        return got_through;
    case CHANGE_MODE:
        snprintf(path, sizeof path, "%s/y.txt", m->resources);
        return chmod(path, 0777) == 0 || truncate(path, 0) == 0 || unlink(path) == 0;
    case FILL_FILE:
        fd = open("full", O_WRONLY | O_CREAT, 0600);
        if (lseek(fd, 1L << 40, SEEK_SET) >= 0 && write(fd, "x", 1) == 1) got_through = 1;
        return got_through;
    case CONNECT:
        return socket(AF_INET, SOCK_STREAM, 0) >= 0 || socket(AF_UNIX, SOCK_DGRAM, 0) >= 0;
    case SIGNAL_PARENT: {
        struct rlimit more = {RLIM_INFINITY, RLIM_INFINITY};
        return kill(getppid(), 0) == 0 || setrlimit(RLIMIT_DATA, &more) == 0;
    }
    case SAY_DONE:
        for (fd = 3; fd < 32; fd++) write(fd, "d", 1);
        for (;;) usleep(1000);
    }
    return 0;
}
int initialize(Model *m)
{
    if (m->r[MODE] == REFUSE_START) return ERROR;
    if (misbehave(m)) m->r[X] = 100.0;
    if (m->r[MODE] == LEAK)
        for (volatile char *kept = malloc(1 << 20), *at = kept; at && at < kept + (1 << 20); at += 4096) *at = 1;
    return OK;
}
static int update(Model *m, Complex *r)
{
    r[DER_X] = -r[X];
    const int late = m->t > 0.5;
    switch ((int)m->r[MODE]) {
    case CRASH:
        if (late) *(volatile int *)8 = 1;
        break;
    case HANG:
        while (late) usleep(1000);
        break;
    case FAIL:
        return late ? ERROR : OK;
    case REJECT:
        return late ? DISCARD : OK;
    case FLOOD:
        for (int i = 0; i < 100; i++) {
            m->callbacks->logger(m->callbacks->environment, m->name, ERROR, "error", "flood %d", flooded++);
            printf("flood %d\n", flooded);
            fprintf(stderr, "flood %d\n", flooded);
        }
        break;
    case NOT_A_NUMBER:
        if (late) r[DER_X] = NAN;
        break;
    case GONE:
        if (late) exit(0);
        break;
    case FATALLY:
        return late ? FATAL : OK;
    case STIFFEN: /* never smooth: no step is small enough */
        r[DER_X] = sin(1e18 * m->t) * 1e30;
        break;
    case BLOW_UP:
        r[DER_X] = 1.0 + r[X] * r[X];
        break;
    }
    return OK;
}
int discrete(Model *m, Events *e)
{
    e->again = m->r[MODE] == EVENTS_FOREVER;
    return OK;
}
