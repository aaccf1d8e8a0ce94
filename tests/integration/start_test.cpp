// Tests how raynestd starts: refusals with their exit codes, and the files that it leaves.
#include "tests/integration/daemon.h"

#include <doctest/doctest.h>
#include <signal.h>
#include <sys/stat.h>

#include <fstream>

namespace raynest::test {
namespace {

bool has(const Ended& ended, std::string_view text) {
    return ended.output.find(text) != std::string::npos;
}

TEST_CASE("addresses beyond loopback are refused with exit code 2 and a remedy") {
    for (const char* uri : {"tcp://0.0.0.0:0", "tcp://[::]:0", "tcp://192.0.2.1:0"}) {
        const Ended ended = run_raynestd({"--listen", uri});
        CHECK(ended.exit_code == 2);
        CHECK(has(ended, "listen on tls://, or pass --insecure"));
        CHECK(std::count(ended.output.begin(), ended.output.end(), '\n') == 1);
    }
}

TEST_CASE("an address in use is an error that names it and a remedy") {
    const Daemon daemon;
    const std::string uri = "tcp://127.0.0.1:" + std::to_string(daemon.port());
    const Ended ended = run_raynestd({"--listen", uri});
    CHECK(ended.exit_code == 1);
    CHECK(has(ended, uri));
    CHECK(has(ended, "another port"));
}

TEST_CASE("what --print-config writes, --config reads") {
    const TemporaryFolder folder;
    const std::string file = (folder.path() / "raynestd.toml").string();
    const Ended first = run_raynestd({"--threads", "3", "--memory", "1G", "--log-level", "warn",
                                      "--listen", "unix:/tmp/a", "--print-config"});
    REQUIRE(first.exit_code == 0);
    CHECK(has(first, "frame_bytes_max = 67108864"));
    CHECK(has(first, "give-way-ms = \"5000\""));
    std::ofstream(file) << first.output;
    const Ended second = run_raynestd({"--config", file, "--print-config"});
    CHECK(second.exit_code == 0);
    CHECK(second.output == first.output);
    CHECK(has(second, "threads = \"3\""));
}

TEST_CASE("a Unix socket is private, replaces a dead one, and goes with the daemon") {
    const TemporaryFolder folder;
    const std::string path = (folder.path() / "socket").string();
    {
        Daemon daemon({"--listen", "unix:" + path});
        struct stat status {};
        REQUIRE(stat(path.c_str(), &status) == 0);
        CHECK((status.st_mode & 0777) == 0600);
        const Ended second = run_raynestd({"--listen", "unix:" + path});
        CHECK(second.exit_code == 1);
        CHECK(has(second, "another path"));
        daemon.signal(SIGKILL);
        CHECK(daemon.wait() == 128 + SIGKILL);
    }
    CHECK(std::filesystem::exists(path));
    {
        Daemon daemon({"--listen", "unix:" + path});
        daemon.signal(SIGTERM);
        CHECK(daemon.wait() == 0);
    }
    CHECK_FALSE(std::filesystem::exists(path));
}

TEST_CASE("two daemons do not share a state folder") {
    const TemporaryFolder folder;
    const std::string state = (folder.path() / "state").string();
    const Daemon daemon({"--state", state});
    const Ended ended = run_raynestd({"--listen", "tcp://127.0.0.1:0", "--state", state});
    CHECK(ended.exit_code == 1);
    CHECK(has(ended, "another daemon"));
}

TEST_CASE("a forced target that does not exist is a usage error") {
    CHECK(run_raynestd({"--target", "v9"}).exit_code == 2);
}

}  // namespace
}  // namespace raynest::test
