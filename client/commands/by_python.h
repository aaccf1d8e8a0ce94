// Commands that the Python package makes of several requests: what a lidar measures, with the words of
// raynest.returns.measure(), rays with times of their own, and pictures of a camera in motion.
#pragma once

#include "client/commands/command.h"
#include "client/commands/query.h"
#include "client/requests/film.h"

#include <string>

namespace raynest::client {

/// Adds the options that make it one.
void add_measure(CommandLine& line, QueryOptions& query);

/// Adds the options of a camera in motion.
void add_trajectory(CommandLine& line, RenderOptions& render);

/// True for such a query, or picture.
[[nodiscard]] bool is_by_python(const QueryOptions& query);
[[nodiscard]] bool is_by_python(const RenderOptions& render);
/// Fails where an option does not go with it.
Result<void> check_by_python(const QueryOptions& query);
Result<void> check_by_python(const RenderOptions& render);

/// Makes this process the Python program that carries it out. Returns only where that fails.
Failure become_program(QueryOptions query, const DaemonPlace& place);
Failure become_program(RenderOptions render, const DaemonPlace& place);

/// A command that the Python package carries out where is_by_python() says so of its options.
template <class Options>
class PythonCommandOf : public CommandOf<Options> {
    [[nodiscard]] Result<bool> is_by_python() const override {
        if (!client::is_by_python(this->options_)) return false;
        return check_by_python(this->options_).map([] { return true; });
    }
    [[nodiscard]] Failure become_program(const DaemonPlace& place) const override {
        return client::become_program(this->options_, place);
    }
};

}  // namespace raynest::client
