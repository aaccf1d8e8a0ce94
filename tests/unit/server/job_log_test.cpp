// Lines of the log about jobs.
#include "server/scheduling/job_log.h"

#include "tests/temporary_folder.h"

#include <doctest/doctest.h>
#include <fcntl.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <fstream>
#include <functional>
#include <optional>
#include <sstream>
#include <string>

namespace raynest::server {
namespace {

/// Returns what is written to stderr meanwhile.
std::string written(const std::function<void()>& act) {
    const test::TemporaryFolder folder;
    const std::string file = (folder.path() / "log").string();
    (void)std::fflush(stderr);
    const int kept = dup(2), log = open(file.c_str(), O_CREAT | O_WRONLY, 0600);
    dup2(log, 2);
    act();
    (void)std::fflush(stderr);
    dup2(kept, 2);
    close(kept);
    close(log);
    std::ostringstream text;
    text << std::ifstream(file).rdbuf();
    return text.str();
}

TEST_CASE("a short job is told at info where something cut it off, and not where it is done") {
    const auto logged = [](std::optional<protocol::Error> error) {
        JobRecord record;
        record.number = 7;
        record.kind = "render";
        record.started = Clock::now();
        return written(
            [&] { log_job(record, record.started + std::chrono::milliseconds(5), error); });
    };
    CHECK(logged({}).empty());
    CHECK(logged(protocol::Error{Code::invalid_field, "no", 0}).empty());
    for (const Code code : {Code::cancelled, Code::draining, Code::not_allowed}) {
        const std::string line = logged(protocol::Error{code, "why", 0});
        CAPTURE(line);
        CHECK(line.find("number=7") != std::string::npos);
        CHECK(line.find("outcome=") != std::string::npos);
    }
}

}  // namespace
}  // namespace raynest::server
