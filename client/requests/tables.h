// --set NAME=@FILE: the values of a parameter that is a table.
#pragma once

#include "client/ground/failure.h"
#include "client/requests/request_options.h"

#include <string>
#include <vector>

namespace raynest::client {

/// Moves the settings of the form NAME=@FILE to `tables`, with the numbers of the file: a .npy of
/// one dimension, or text with numbers between commas and white space. Exit code 5 names the file.
Result<void> read_tables(std::vector<std::string>& settings, std::vector<TableOption>& tables);

}  // namespace raynest::client
