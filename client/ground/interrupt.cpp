#include "client/ground/interrupt.h"

#include <signal.h>

namespace raynest::client {
namespace {

volatile sig_atomic_t seen = 0;

void note(int) {
    seen = 1;
}

}  // namespace

void catch_interrupts() {
    struct sigaction action = {};
    action.sa_handler = note;
    // No SA_RESTART: a waiting poll() must wake up. SA_RESETHAND: a second signal ends the process.
    action.sa_flags = static_cast<int>(SA_RESETHAND);
    sigemptyset(&action.sa_mask);
    sigaction(SIGINT, &action, nullptr);
    sigaction(SIGTERM, &action, nullptr);
    // The end of the terminal. nohup has it ignored: then it stays so.
    struct sigaction before = {};
    if (sigaction(SIGHUP, nullptr, &before) == 0 && before.sa_handler != SIG_IGN)
        sigaction(SIGHUP, &action, nullptr);
    signal(SIGPIPE, SIG_IGN);
}

bool interrupted() {
    return seen != 0;
}

}  // namespace raynest::client
