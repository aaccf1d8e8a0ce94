// Plain sockets for the load test: connected pairs of the kind that the daemon is reached by.
#pragma once

#include "client/failure.h"

#include <utility>
#include <vector>

namespace raynest::client {

/// A file descriptor that is closed with its owner. Move-only.
class Descriptor {
public:
    explicit Descriptor(int number = -1) : number_(number) {}
    Descriptor(Descriptor&& other) noexcept : number_(std::exchange(other.number_, -1)) {}
    Descriptor& operator=(Descriptor&& other) noexcept {
        std::swap(number_, other.number_);
        return *this;
    }
    Descriptor(const Descriptor&) = delete;
    ~Descriptor();
    [[nodiscard]] int number() const { return number_; }
    /// The number, which the caller closes from now on.
    [[nodiscard]] int release() { return std::exchange(number_, -1); }

private:
    int number_;
};

/// The two ends of connections within this process.
struct SocketPairs {
    std::vector<Descriptor> near;
    std::vector<Descriptor> far;
};
/// `count` of them, over a Unix socket where `like` is one, else over loopback TCP.
Result<SocketPairs> connect_pairs(int like, std::size_t count);

}  // namespace raynest::client
