// A file that a client sends with a request, piece by piece: UPLOAD frames.
#pragma once

#include "protocol/buffer.h"
#include "protocol/control.h"
#include "protocol/wire.h"
#include "server/errors.h"

#include <cstdint>
#include <cstring>
#include <span>
#include <string>

namespace raynest::server {

/// Room for a file of a size that is known before.
class ReceivedFile {
public:
    ReceivedFile(std::uint32_t number, std::uint64_t bytes) : number_(number), bytes_(bytes) {}

    [[nodiscard]] bool complete() const { return received_ == bytes_.size(); }
    [[nodiscard]] std::span<const std::byte> bytes() const { return bytes_.span(); }
    [[nodiscard]] std::uint64_t received() const { return received_; }
    /// Takes the next piece; fails with INVALID_FIELD if it is not the next one.
    Reply<void> take(const wire::Upload& piece, std::span<const std::byte> data) {
        if (piece.file() != number_ || piece.offset() != received_)
            return refuse(Code::invalid_field, "expected byte " + std::to_string(received_) +
                                                   " of file " + std::to_string(number_) +
                                                   " next");
        if (data.size() > bytes_.size() - received_)
            return refuse(Code::invalid_field, "file " + std::to_string(number_) +
                                                   " is longer than its announced " +
                                                   std::to_string(bytes_.size()) + " bytes");
        if (!data.empty()) std::memcpy(bytes_.data() + received_, data.data(), data.size());
        received_ += data.size();
        return {};
    }
    /// Frees the memory.
    void drop() {
        bytes_ = {};
        received_ = 0;
    }

private:
    std::uint32_t number_;
    protocol::Buffer bytes_;
    std::uint64_t received_ = 0;
};

}  // namespace raynest::server
