// Many clients on one thread: each sends its request, waits for the end of the answer, and sends it
// again.
//
// Closed loop: at once. Open loop: at fixed times, and latency counts from the time at which a
// request was due. While a server stalls requests go on being due; they are sent late, and those
// that cannot be sent any more are counted as missed, so that it is seen to be late for all that
// came meanwhile. The same driver measures the daemon and the controls: what it costs is in both.
#pragma once

#include "client/load_test/latencies.h"
#include "client/load_test/sockets.h"
#include "protocol/frame.h"

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace raynest::client {

/// What came back, over all runs.
struct LoadTally {
    /// Of requests that were answered well, and how late those are that were missed: at least.
    Latencies latencies;
    std::uint64_t refused = 0;
    std::uint64_t missed = 0;  ///< due in an open loop, and never sent
    std::uint64_t bytes = 0;   ///< both ways
    std::chrono::duration<double> time{0};
    std::optional<Failure> refusal;  ///< the last one

    [[nodiscard]] std::uint64_t answered() const { return latencies.count() - missed; }
};

/// By how much longer a turn lasts at most, so that an open loop catches up.
inline constexpr std::chrono::seconds overtime_max{5};

class Driver {
public:
    /// One client per socket, which stay the caller's; `requests` are frames as they travel, one
    /// or more per client, and outlive the driver.
    Driver(std::vector<int> sockets, std::vector<std::span<const std::byte>> requests);

    /// Sends for `time`, then waits for what is under way; `rate` requests per second of all
    /// clients together, 0: closed loop. A client of an open loop that is behind goes on until what
    /// was due within `time` is sent or overtime_max has passed; the next run takes the schedule up
    /// where this one left it. Fails when a connection ends or an answer does not come.
    Result<void> run(std::chrono::nanoseconds time, double rate, LoadTally& tally);

    /// The bytes of the first answer that was no refusal; empty while there is none.
    [[nodiscard]] const std::vector<std::byte>& sample() const { return sample_; }

private:
    using Clock = std::chrono::steady_clock;
    struct Client {
        Client(int number, std::span<const std::byte> bytes);
        int socket;
        std::span<const std::byte> request;
        protocol::FrameDecoder decoder;
        std::size_t unsent = 0;
        /// So far; only while it may become the sample.
        std::vector<std::byte> answer;
        Clock::time_point due{};  ///< of the request under way, or of the next one
        double phase = 0;         ///< open loop: when a run begins, intervals until one is due
        bool waiting = false;     ///< for the end of an answer
        bool finished = false;    ///< with this run
    };

    Result<void> start(Client& client, LoadTally& tally);
    Result<void> send_rest(Client& client);
    Result<void> receive(Client& client, LoadTally& tally);
    void ended(Client& client, const protocol::Frame& last, Clock::time_point now,
               LoadTally& tally);
    Result<void> start_due(Clock::time_point now, LoadTally& tally);
    Result<void> take_events(Clock::time_point now, LoadTally& tally);
    [[nodiscard]] bool open_loop() const { return interval_.count() != 0; }
    void finish(Client& client);
    void give_up(Clock::time_point now, LoadTally& tally);

    std::vector<Client> clients_;
    Descriptor events_;
    std::vector<std::byte> staging_;
    std::vector<std::byte> sample_;
    std::size_t unfinished_ = 0;
    Clock::time_point end_{};
    Clock::time_point cut_{};                  ///< nothing is sent any more
    Clock::duration overtime_ = overtime_max;  ///< halved by each run that needed more
    Clock::duration interval_{0};  ///< between two requests of one client; 0: closed loop
};

}  // namespace raynest::client
