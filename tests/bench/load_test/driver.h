// Many clients on one thread: each sends its request, waits for the end of the answer, and sends it
// again.
//
// A closed loop sends the next request at once. An open loop sends at fixed times, and latency
// counts from the time when a request was due. While a server stalls, requests become due all the
// same: they are sent late, and those that cannot be sent any more count as missed. The driver
// measures the daemon and the controls alike, so that its own cost is in both.
#pragma once

#include "protocol/frame.h"
#include "tests/bench/load_test/latencies.h"
#include "tests/bench/load_test/sockets.h"

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace raynest::client {

/// Results of all runs.
struct LoadTestStatistics {
    /// Latencies of answered requests, and lower bounds of those of missed ones.
    Latencies latencies;
    std::uint64_t refused = 0;
    std::uint64_t missed = 0;  ///< requests of an open loop that were never sent
    std::uint64_t bytes = 0;   ///< both ways
    std::chrono::duration<double> time{0};
    std::optional<Failure> refusal;  ///< the last one

    [[nodiscard]] std::uint64_t answered() const { return latencies.count() - missed; }
};

/// Maximum time by which a turn is prolonged so that an open loop can catch up.
inline constexpr std::chrono::seconds overtime_max{5};

class Driver {
public:
    /// Makes a client per socket; the caller keeps the sockets. `requests` are the bytes of frames,
    /// one or more per client, and outlive the driver.
    Driver(std::vector<int> sockets, std::vector<std::span<const std::byte>> requests);

    /// Sends for `time`, then waits for the last answers. `rate` is the number of requests per
    /// second of all clients together; 0: closed loop. An open loop that is behind continues until
    /// all requests due within `time` are sent or overtime_max has passed; the next run continues
    /// the schedule. Fails if a connection ends or an answer does not come.
    Result<void> run(std::chrono::nanoseconds time, double rate, LoadTestStatistics& statistics);

    /// Returns the bytes of the first answer that was not a refusal; empty if there is none yet.
    [[nodiscard]] const std::vector<std::byte>& sample() const { return sample_; }

private:
    using Clock = std::chrono::steady_clock;
    struct Client {
        Client(int number, std::span<const std::byte> bytes);
        int socket;
        std::span<const std::byte> request;
        protocol::FrameDecoder decoder;
        std::size_t unsent = 0;
        /// The answer so far, kept only while it may become the sample.
        std::vector<std::byte> answer;
        Clock::time_point due{};  ///< due time of the current or next request
        double phase = 0;         ///< open loop: intervals from the run's begin to the next request
        bool waiting = false;     ///< an answer has not ended yet
        bool finished = false;    ///< with this run
    };

    Result<void> start(Client& client, LoadTestStatistics& statistics);
    Result<void> send_rest(Client& client);
    Result<void> receive(Client& client, LoadTestStatistics& statistics);
    void ended(Client& client, const protocol::Frame& last, Clock::time_point now,
               LoadTestStatistics& statistics);
    Result<void> start_due(Clock::time_point now, LoadTestStatistics& statistics);
    Result<void> take_events(Clock::time_point now, LoadTestStatistics& statistics);
    [[nodiscard]] bool open_loop() const { return interval_.count() != 0; }
    void finish(Client& client);
    void give_up(Clock::time_point now, LoadTestStatistics& statistics);

    std::vector<Client> clients_;
    Descriptor events_;
    std::vector<std::byte> staging_;
    std::vector<std::byte> sample_;
    std::size_t unfinished_ = 0;
    Clock::time_point end_{};
    Clock::time_point cut_{};                  ///< end of sending
    Clock::duration overtime_ = overtime_max;  ///< halved by each run that needed more
    Clock::duration interval_{0};  ///< between two requests of one client; 0: closed loop
};

}  // namespace raynest::client
