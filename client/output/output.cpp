#include "client/output/output.h"

#include "client/ground/interrupt.h"

#include <poll.h>
#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

namespace raynest::client {
namespace {

bool is_number(const std::string& text) {
    return text == "-" || (!text.empty() && (std::isdigit(static_cast<unsigned char>(text[0])) ||
                                             (text[0] == '-' && text.size() > 1)));
}

/// Counts letters, not bytes: names may be UTF-8.
std::size_t letters(const std::string& text) {
    return static_cast<std::size_t>(std::count_if(text.begin(), text.end(), [](char c) {
        return (static_cast<unsigned char>(c) & 0xC0) != 0x80;
    }));
}

}  // namespace

void end_if_unread() {
    pollfd out{STDOUT_FILENO, POLLOUT, 0};
    if (::poll(&out, 1, 0) == 1 && (out.revents & POLLERR) != 0) {
        ::signal(SIGPIPE, SIG_DFL);
        ::raise(SIGPIPE);
    }
}

Result<void> check_stdout() {
    errno = 0;
    std::cout.flush();
    if (std::cout) return {};
    const int why = errno;  // 0 if an earlier write failed
    if (interrupted()) return fail(Exit::interrupted, "interrupted");
    end_if_unread();
    return fail(Exit::failed,
                "cannot write stdout" + (why == 0 ? "" : std::string(": ") + std::strerror(why)));
}

void print_json(const Json& value, std::ostream& to) {
    to << json_text(value) << '\n';
}

void print_table(const std::vector<std::vector<std::string>>& rows) {
    std::vector<std::size_t> widths;
    for (const auto& row : rows) {
        widths.resize(std::max(widths.size(), row.size()), 0);
        for (std::size_t i = 0; i < row.size(); ++i)
            widths[i] = std::max(widths[i], letters(row[i]));
    }
    // Align a column of numbers to the right, with its title.
    std::vector<bool> right(widths.size(), rows.size() > 1);
    for (std::size_t r = 1; r < rows.size(); ++r)
        for (std::size_t i = 0; i < rows[r].size(); ++i)
            if (!is_number(rows[r][i])) right[i] = false;
    for (const auto& row : rows) {
        std::string line;
        for (std::size_t i = 0; i < row.size(); ++i) {
            const std::string blanks(widths[i] - letters(row[i]), ' ');
            line += (i == 0 ? "" : "  ") + (right[i] ? blanks + row[i] : row[i] + blanks);
        }
        line.erase(line.find_last_not_of(' ') + 1);
        std::cout << line << '\n';
    }
}

PrintWatch::PrintWatch(std::ostream& stream) : stream_(stream), target_(stream.rdbuf()) {
    stream_.rdbuf(this);
}

PrintWatch::~PrintWatch() {
    stream_.rdbuf(target_);
}

PrintWatch::int_type PrintWatch::overflow(int_type c) {
    printed_ = true;
    return traits_type::eq_int_type(c, traits_type::eof())
               ? traits_type::not_eof(c)
               : target_->sputc(traits_type::to_char_type(c));
}

std::streamsize PrintWatch::xsputn(const char* text, std::streamsize size) {
    printed_ = true;
    return target_->sputn(text, size);
}

}  // namespace raynest::client
