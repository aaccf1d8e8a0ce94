// RENDER of one path in place of a picture.
#pragma once

#include "server/requests/request.h"
#include "server/requests/words/render_words.h"

#include <string_view>

namespace raynest::server {

/// The beginning of an encoding that asks for the path of a pixel: "path+480,270".
inline constexpr std::string_view path_encoding = "path+";
/// Explains the last sample of a pixel of a lit picture, which the encoding names.
Reply<Answer> explain_path(const Services& services, const Caller& caller, RenderWords words);

}  // namespace raynest::server
