/* An external controller in C: a spring at the joint, 200 times a second, over the local socket.
 *
 *     cc -o spring spring.c && ./spring SOCKET AXIS STIFFNESS
 *
 * SOCKET is the socket of the daemon, as for `tsa status`; STIFFNESS is in N*m/rad. It ends when the daemon ends or the
 * lease is lost.
 */
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

static double number(const char *text, const char *key) { /* after "key": */
    return (text = strstr(text, key)) ? atof(text + strlen(key)) : 0.0;
}

int main(int argc, char **argv) {
    struct sockaddr_un daemon = {.sun_family = AF_UNIX};
    char line[65536], axis[80];
    int fd = socket(AF_UNIX, SOCK_STREAM, 0);
    signal(SIGPIPE, SIG_IGN); /* so that the last message of the daemon can still be read */
    if (argc != 4) return fprintf(stderr, "usage: %s SOCKET AXIS STIFFNESS\n", argv[0]), 2;
    snprintf(daemon.sun_path, sizeof daemon.sun_path, "%s", argv[1]);
    snprintf(axis, sizeof axis, "\"name\":\"%s\"", argv[2]);
    if (connect(fd, (struct sockaddr *)&daemon, sizeof daemon)) return perror(argv[1]), 1;
    FILE *in = fdopen(fd, "r"), *out = fdopen(dup(fd), "w");
    fprintf(out, "{\"verb\":\"lease\",\"seconds\":0.2}\n");
    for (;; nanosleep(&(struct timespec){.tv_nsec = 5000000}, NULL)) {
        fprintf(out, "{\"verb\":\"measure\"}\n");
        fflush(out);
        do { /* skip answers and lease events before the measurement */
            if (!fgets(line, sizeof line, in)) return fprintf(stderr, "the daemon is gone\n"), 1;
            if (strstr(line, "\"ok\":false") || strstr(line, "\"held\":false")) return fputs(line, stderr), 1;
        } while (!strstr(line, "\"axes\":"));
        const char *joint = strstr(line, axis);
        if (!joint) return fprintf(stderr, "no axis %s\n", argv[2]), 1;
        fprintf(out, "{\"verb\":\"setpoint\",\"axis\":\"%s\",\"value\":%.6f,\"time\":%.9f,\"quiet\":true}\n", argv[2],
                -atof(argv[3]) * number(joint, "\"q_j\":"), number(line, "\"time\":"));
    }
}
