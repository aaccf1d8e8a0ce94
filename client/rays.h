// Where a query's rays come from: the command line or a .npy file.
#pragma once

#include "client/failure.h"
#include "client/npy.h"
#include "client/options.h"
#include "protocol/buffer.h"

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace raynest::client {

class RaySource {
public:
    explicit RaySource(std::vector<Ray> rays);
    /// An array of shape (N, 6), origins and directions, or (N, 8), rows as the protocol's rays; of
    /// float32 or float64, which is rounded. Exit code 5 for anything else.
    static Result<RaySource> open(const std::string& path);

    [[nodiscard]] std::uint64_t count() const { return count_; }
    /// Rays [first, first + count) as they travel, where they lie so in memory; else nothing.
    [[nodiscard]] std::span<const std::byte> bytes(std::uint64_t first, std::uint64_t count) const;
    /// Writes rays [first, first + out.size()).
    void read(std::uint64_t first, std::span<Ray> out) const;

private:
    RaySource() = default;
    std::vector<Ray> rays_;
    protocol::Buffer file_;
    Array array_;
    std::uint64_t count_ = 0;
};

}  // namespace raynest::client
