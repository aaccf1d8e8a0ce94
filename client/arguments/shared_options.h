// The options that several commands have.
#pragma once

#include "client/arguments/command_line.h"
#include "client/requests/film.h"
#include "client/requests/request_options.h"

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace raynest::client {

/// Returns the exit codes as help lists them.
std::string exit_codes();
void add_scene(CommandLine& line, std::string& scene);
void add_epoch(CommandLine& line, std::uint64_t& epoch);
void add_deadline(CommandLine& line, double& deadline, const char* text);
void add_job(CommandLine& line, JobOptions& job);
/// --animation, and --time with it.
void add_animation(CommandLine& line, MomentOptions& moment);
Option add_moment(CommandLine& line, MomentOptions& moment);
void add_camera(CommandLine& line, CameraOptions& camera);
/// Adds -o FILE with one of these endings, in small or capital letters, or "-" for stdout.
Option add_output(CommandLine& line, std::string& output, const std::vector<std::string>& endings,
                  const std::string& text, bool to_stdout = true);
/// Adds --kind, --max-hits and --fields. Uses the one check at the end that a command has.
void add_kind(CommandLine& line, std::string& kind, std::uint32_t& max_hits,
              std::vector<std::string>& fields);
/// Adds --detach, with which a file that is otherwise required may be left out. In that case it
/// uses the one check at the end that a command has.
void add_detach(CommandLine& line, JobOptions& job, const std::string* required_output);
/// Adds --part I/N.
Option add_part(CommandLine& line, PartOption& part);
void add_progressive(CommandLine& line, bool& progressive);
void add_environment(CommandLine& line, std::string& environment);
/// Adds what chooses the paths of light; samples are the caller's.
void add_light(CommandLine& line, LightOptions& light, const std::string& integrators);
/// add_light(), samples, and what becomes of the light in a picture.
void add_film(CommandLine& line, RenderOptions& render);
/// Adds --generate, whose words parse_generate() takes.
void add_generate(CommandLine& line, std::vector<std::string>& generate, const std::string& text);
void add_job_number(CommandLine& line, std::uint64_t& job);
Option add_point(CommandLine& line, const std::string& name, const std::string& text,
                 std::function<void(const WorldPoint&)> take);

}  // namespace raynest::client
