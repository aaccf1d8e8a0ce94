#include "protocol/subject.h"

#include <doctest/doctest.h>

#include <string>
#include <vector>

using raynest::protocol::in_list;
using raynest::protocol::is_subject;
using raynest::protocol::split_principals;
using Names = std::vector<std::string>;

TEST_CASE("a subject has the form in which the daemon names principals") {
    for (const char* good : {"CN=robot", "CN=robot,O=Lab", "O=Lab 7,CN=robot",
                             "CN=a+UID=7,DC=x,DC=y", "2.5.4.3=a", "CN=Smith\\, John", "CN=a\\\\b",
                             "CN=J\xc3\xbcrg", "CN=\\20a\\ ", "CN=#04", "CN=a=b", "CN="})
        CHECK_MESSAGE(is_subject(good), good);
    for (const char* bad : {"", "robot", "CN = robot", "CN=robot, O=Lab", "/CN=robot/O=Lab,",
                            "CN=robot,", "=robot", "CN=a\nb", "CN=a\x1b", "CN=a;b", "CN=\"a\"",
                            "CN=a\\", "CN= a", "CN=a ", "CN=\xff", "CN=a,,O=b"})
        CHECK_MESSAGE(!is_subject(bad), bad);
    CHECK(is_subject("CN=" + std::string(197, 'a')));
    CHECK_FALSE(is_subject("CN=" + std::string(198, 'a')));
}

TEST_CASE("a list of principals is split at commas that are not escaped") {
    CHECK(*split_principals("public") == Names{"public"});
    CHECK(*split_principals("alice,uid:7,::1") == Names{"alice", "uid:7", "::1"});
    CHECK(*split_principals("CN=robot\\,O=Lab") == Names{"CN=robot,O=Lab"});
    CHECK(*split_principals("bob,CN=robot\\,O=Lab,eve") == Names{"bob", "CN=robot,O=Lab", "eve"});
    CHECK(*split_principals("CN=Smith\\\\\\, John\\,O=Lab") == Names{"CN=Smith\\, John,O=Lab"});
    for (const char* unclear : {"CN=robot,O=Lab", "bob,CN=a,CN=b", "CN=Smith\\, John", "CN = robot",
                                "", "a,", ",a", "a,,b"})
        CHECK_MESSAGE(!split_principals(unclear), unclear);
    for (const char* name : {"alice", "CN=robot,O=Lab", "CN=Smith\\, John,O=Lab"})
        CHECK(*split_principals(in_list(name)) == Names{name});
}
