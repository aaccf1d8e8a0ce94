// Finds a daemon again that went away, and tells whether a command may then run once more.
#pragma once

#include "client/connection.h"
#include "client/options.h"

#include <functional>
#include <memory>
#include <streambuf>

namespace raynest::client {

using Connect = std::function<Result<std::unique_ptr<Connection>>()>;

/// Tries to connect for `seconds`, and longer while something accepts connections and stays silent, or
/// says that it ends: a service manager holds the socket until the next daemon is up. Fails with `why` if none comes, or with the daemon's
/// refusal.
Result<std::unique_ptr<Connection>> reconnect(const Connect& connect, double seconds,
                                              const Failure& why);

/// True if a first attempt to connect may be followed by others: the daemon says that it ends, or it was
/// killed while its socket, which a service manager holds, lives on. A server that stays silent may be
/// of another kind, and is not waited for.
[[nodiscard]] bool may_connect_again(const Failure& why);

/// True if the command does the same when it runs again after `why`: it changes nothing, or what it
/// loads can be read once more. `printed`: a part of its answer is on stdout.
[[nodiscard]] bool may_repeat(const CommandOptions& command, const Failure& why, bool printed);

/// Notices whether anything was written to a stream.
class PrintWatch final : public std::streambuf {
public:
    explicit PrintWatch(std::ostream& stream);
    ~PrintWatch() override;
    PrintWatch(const PrintWatch&) = delete;
    [[nodiscard]] bool printed() const { return printed_; }

private:
    int_type overflow(int_type c) override;
    std::streamsize xsputn(const char* text, std::streamsize size) override;
    int sync() override { return target_->pubsync(); }

    std::ostream& stream_;
    std::streambuf* const target_;
    bool printed_ = false;
};

}  // namespace raynest::client
