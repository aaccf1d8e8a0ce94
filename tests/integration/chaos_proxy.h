// A proxy between one client and a daemon that does harm at one point of the conversation; equal
// seeds do equal harm. It never changes a byte: it is a bad network, not a bad client.
#pragma once

#include "protocol/frame.h"
#include "protocol/wire.h"

#include <atomic>
#include <cstdint>
#include <random>
#include <string>
#include <string_view>
#include <thread>

namespace raynest::test {

enum class Part { header, control, bulk };

/// The message and the part of it at which the harm is done, on its first occurrence.
struct Point {
    wire::Message message;
    Part part;
    [[nodiscard]] std::string name() const;
};

enum class Harm { delay, drip, stall, cut, half_close, reset };
inline constexpr unsigned harm_count = 6;
[[nodiscard]] std::string_view harm_name(Harm harm);

class ChaosProxy {
public:
    /// Listens on a free loopback port and serves its first client. The seed chooses the harm and
    /// the byte of the part.
    ChaosProxy(std::uint16_t daemon_port, Point point, std::uint64_t seed);
    /// Waits until both ends have closed. They must do so by themselves: see the .cpp.
    ~ChaosProxy();
    ChaosProxy(const ChaosProxy&) = delete;

    [[nodiscard]] std::uint16_t port() const { return port_; }
    [[nodiscard]] Harm harm() const { return harm_; }
    /// True if all bytes arrive, even if late.
    [[nodiscard]] bool harmless() const { return harm_ == Harm::delay || harm_ == Harm::drip; }
    /// True once the point occurred and the harm was done.
    [[nodiscard]] bool struck() const { return struck_; }

private:
    /// One direction, with its position in the current frame.
    struct Lane {
        Lane(int source, int target) : from(source), to(target) {}
        const int from;
        const int to;
        bool open = true;
        protocol::FrameHeader header;
        std::byte header_bytes[protocol::header_bytes] = {};
        Part part = Part::header;
        std::uint64_t at = 0;  ///< bytes of the part so far
    };

    void serve();
    /// Forwards the received bytes; false when the conversation is over.
    bool forward(Lane& lane, Lane& other);
    /// Returns how many of these bytes lie before the point; all of them if it is not among them.
    std::size_t until_point(Lane& lane, const std::byte* bytes, std::size_t count);
    [[nodiscard]] static std::uint64_t length(const Lane& lane, Part part);
    bool do_harm(Lane& lane, Lane& other);

    const Point point_;
    std::mt19937_64 random_;
    const Harm harm_;
    const std::uint64_t byte_;  ///< index in the part, modulo its length
    const std::uint16_t daemon_port_;
    int listener_ = -1;
    std::uint16_t port_ = 0;
    std::size_t drip_ = 0;  ///< bytes still to be sent one by one
    std::atomic<bool> struck_{false};
    std::thread thread_;
};

}  // namespace raynest::test
