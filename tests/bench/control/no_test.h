// The control of the controls: nothing is asked, nothing is compiled in.
#pragma once

namespace raynest {

struct NoTest {
    static constexpr const char* text = "control: no test";
};

}  // namespace raynest
