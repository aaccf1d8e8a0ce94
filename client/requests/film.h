// Requests for lit pictures: their fields, and the files that are sent with them.
#pragma once

#include "client/requests/picture.h"
#include "client/requests/request_options.h"
#include "protocol/buffer.h"

#include <string>

namespace raynest::client {

struct RenderOptions : PictureOptions, LightOptions {
    std::uint32_t samples = 0;  ///< 0: those of the integrator
    std::string tonemap, exposure;
    bool progressive = false;
    float noise = 0;
    float environment_rotate = 0;  ///< degrees
    bool all_cameras = false;
    std::string trajectory;  ///< file of the poses of a camera in motion
    double begin = 0, readout = 0;
    double step_error = 0;  ///< 0: the scene stands still
};
struct ResumeOptions {
    std::string file;
    std::uint32_t samples = 0;
    std::string output;  ///< empty: `file`
    std::string scene;   ///< empty: the one that the file names
    std::string environment;
    bool progressive = false;
    double deadline = 0;
};

/// Files that follow a Render; empty ones are not sent.
struct FilmFiles {
    protocol::Buffer resumed;      ///< an EXR to continue: file 0
    protocol::Buffer environment;  ///< a picture of the surroundings: file 1
    std::string environment_name;  ///< name of the picture's file, for messages
};

/// Samples of each pixel, as they were asked for or as the integrator has them.
[[nodiscard]] std::uint32_t samples_of(const RenderOptions& options);

/// Sets what a Render has beside the fields of all pictures, and reads the files.
Result<void> fill_film(const RenderOptions& options, wire::RenderT& request, FilmFiles& files);

/// Sets the fields of a Render that choose its paths, but for files.
void set_light(const LightOptions& options, wire::RenderT& request);

/// Makes the request that continues an EXR, out of the EXR.
Result<wire::RenderT> resumed_film(const ResumeOptions& options, FilmFiles& files);

/// Sends a Render and its files, and reads the answer.
Result<ReceivedFile> run_film(Connection& connection, Progress& progress,
                              const wire::RenderT& request, const FilmFiles& files,
                              const PassConsumer& consume_pass);
/// The same for the camera of the options.
Result<ReceivedFile> ask_film(Connection& connection, Progress& progress,
                              const PictureOptions& options, wire::RenderT request,
                              const FilmFiles& files, const PassConsumer& consume_pass);

}  // namespace raynest::client
