#include "client/ground/python.h"

#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <utility>

namespace raynest::client {
namespace {

/// A package that is missing is one line, which names it.
/// A Ctrl-C waits until somebody can tell it in a line.
constexpr const char* start = R"(import sys
def interrupted():
    print('raynest: interrupted', file=sys.stderr)
    return 130
try:
    import importlib, json, signal
    module = importlib.import_module(sys.argv[1])
except ImportError as error:
    named = str(error) if 'apt install' in str(error) else f'{error}: apt install python3-raynest python3-numpy'
    told = {'error': {'code': 1001, 'name': 'FAILED', 'message': named}}
    sys.exit(json.dumps(told) if sys.argv[2:3] == ['--json'] else 'raynest: ' + named)
except KeyboardInterrupt:
    sys.exit(interrupted())
try:
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    code = module.main(sys.argv[2:])
except KeyboardInterrupt:
    code = interrupted()
sys.exit(code))";

}  // namespace

Failure become_python(const std::string& module, std::vector<std::string> words) {
    const char* named = std::getenv("RAYNEST_PYTHON");
    const std::string program = named != nullptr && *named != '\0' ? named : "python3";
    std::vector<std::string> all = {program, "-c", start, module};
    for (std::string& word : words) all.push_back(std::move(word));
    std::vector<char*> pointers;
    for (std::string& word : all) pointers.push_back(word.data());
    pointers.push_back(nullptr);
    std::cout.flush();
    sigset_t interrupt;
    ::sigemptyset(&interrupt);
    ::sigaddset(&interrupt, SIGINT);
    ::pthread_sigmask(SIG_BLOCK, &interrupt, nullptr);
    ::execvp(pointers.front(), pointers.data());
    return failure(Exit::failed, std::string("this needs ")
                                     .append(program)
                                     .append(", which cannot be started: ")
                                     .append(std::strerror(errno)));
}

}  // namespace raynest::client
