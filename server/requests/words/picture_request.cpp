#include "server/requests/words/picture_request.h"

#include "server/scheduling/peers.h"

#include <utility>

namespace raynest::server {
namespace {

Reply<PictureRequest> make_checked(const Services& services, const Caller& caller, Plan plan,
                                   const CameraRequest& camera, const AskedPixels& pixels,
                                   std::string encode, std::uint64_t bytes,
                                   std::string_view advice) {
    PictureRequest request;
    request.encode = std::move(encode);

    auto chosen = choose_camera(plan.scene.snapshot(), camera);
    // Report an unknown camera as a fault of the request, not of the scene.
    if (!chosen) return refuse(Code::invalid_field, chosen.error().message);
    request.camera = std::move(*chosen);
    const bool asked = camera.look_at || !camera.name.empty();
    if (!asked && plan.scene.snapshot().view().camera_count == 0)
        plan.notes.push_back("the scene has no camera: this one frames its bounding box");

    request.plan = std::move(plan);
    request.width = pixels.size().width;
    request.height = pixels.size().height;
    request.whole = pixels.whole;
    request.window = pixels.window;
    request.request = pixels.request;
    auto lease = services.peers.reserve(bytes, caller.principal);
    if (!lease)
        return services.budget.refuse(
            "a picture of " + std::to_string(request.width) + "x" + std::to_string(request.height),
            bytes, caller.principal,
            std::string(advice) + ", or start raynestd with a larger --memory");
    request.lease = std::move(*lease);
    return request;
}

}  // namespace

Reply<std::string> check_encode(std::string_view word) {
    if (word == "raw") return std::string(word);
    if (word != "png" && word != "exr")
        return refuse(Code::invalid_field,
                      "unknown encode '" + std::string(word) + "': use one of png, exr, raw");
    return std::string(word);
}

Reply<PictureRequest> make_request(const Services& services, const Caller& caller, Plan plan,
                                   const CameraRequest& camera, const AskedPixels& pixels,
                                   std::string_view encode, std::uint64_t bytes) {
    auto word = check_encode(encode);
    if (!word) return tl::unexpected(word.error());
    const std::string advice = smaller_picture(*word);
    return make_checked(services, caller, std::move(plan), camera, pixels, std::move(*word), bytes,
                        advice);
}

Reply<PictureRequest> make_document_request(const Services& services, const Caller& caller,
                                            Plan plan, const CameraRequest& camera,
                                            const AskedPixels& pixels, std::uint64_t bytes,
                                            std::string_view advice) {
    return make_checked(services, caller, std::move(plan), camera, pixels, "json", bytes, advice);
}

std::string smaller_picture(std::string_view encode) {
    return std::string("ask for a smaller `size`") +
           (encode == "exr" ? ", or for PNG in place of EXR" : "");
}

}  // namespace raynest::server
