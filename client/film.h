// Requests for lit pictures: their fields, and the files that are sent with them.
#pragma once

#include "client/options.h"
#include "client/picture.h"
#include "protocol/buffer.h"

#include <string>

namespace raynest::client {

/// Files that follow a Render; empty ones are not sent.
struct FilmFiles {
    protocol::Buffer resumed;      ///< an EXR to continue: file 0
    protocol::Buffer environment;  ///< a picture of the surroundings: file 1
    std::string environment_name;  ///< of the picture's file, for messages
};

/// Sets what a Render has beside the fields of all pictures, and reads the files.
Result<void> fill_film(const RenderOptions& options, wire::RenderT& request, FilmFiles& files);

/// Sets the fields of a Render that choose its paths, but for files.
void set_light(const LightOptions& options, wire::RenderT& request);

/// Makes the request that continues an EXR, out of the EXR.
Result<wire::RenderT> resumed_film(const ResumeOptions& options, FilmFiles& files);

/// Sends a Render and its files, and reads the answer.
Result<ReceivedPicture> run_film(Connection& connection, Progress& progress,
                                 const wire::RenderT& request, const FilmFiles& files,
                                 const PassConsumer& consume_pass);
/// The same for the camera of the options.
Result<ReceivedPicture> ask_film(Connection& connection, Progress& progress,
                                 const PictureOptions& options, wire::RenderT request,
                                 const FilmFiles& files, const PassConsumer& consume_pass);

/// Writes a rendered picture as it came, a raw one as .npy.
Result<void> write_picture(const std::string& output, const ReceivedPicture& picture);

}  // namespace raynest::client
