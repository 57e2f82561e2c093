// The bus alone, in C: SYNC out, all answers in, a command to each drive. The lower bound of a cycle on a raw socket.
#include <linux/can.h>
#include <sys/socket.h>

// Return 1 if all `answers` came, 0 after the receive timeout of the socket, -1 if a frame could not be sent.
int cycle(int bus, const struct can_frame *sync, const struct can_frame *commands, int axes, int answers) {
    struct can_frame frame;
    if (send(bus, sync, sizeof *sync, 0) < 0) return -1;
    for (int n = 0; n < answers; n++)
        if (recv(bus, &frame, sizeof frame, 0) < 0) return 0;
    for (int n = 0; n < axes; n++)
        if (send(bus, commands + n, sizeof *commands, 0) < 0) return -1;
    return 1;
}
