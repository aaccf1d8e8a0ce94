// Formats answers for stdout: aligned tables for people, JSON for programs.
#pragma once

#include "client/ground/failure.h"
#include "client/ground/json.h"

#include <iostream>
#include <streambuf>
#include <string>
#include <vector>

namespace raynest::client {

/// After a failed write: ends this process silently if the reader of stdout, such as head, has
/// gone.
void end_if_unread();

/// Fails if a write to stdout failed. A command that prints much calls this as it goes, so that it
/// stops when its reader does.
[[nodiscard]] Result<void> check_stdout();

void print_json(const Json& value, std::ostream& to = std::cout);

/// Prints columns as wide as their widest cell; columns of numbers are aligned to the right.
void print_table(const std::vector<std::vector<std::string>>& rows);

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
