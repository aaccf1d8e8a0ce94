# cmake -DIN=messages_generated.h -DHEADER=<file> -DSOURCE=<file> -P split_messages.cmake
#
# flatc writes everything into one header, the bodies of the ...T types' functions included: 4,000 of its
# 13,500 lines, which cost each file that reads them 1.5 seconds. Here they go into a source of their own.
file(READ ${IN} text)
string(FIND "${text}" "\ninline BlockT *Block::UnPack(" bodies)
string(FIND "${text}" "\n}  // namespace wire\n" end REVERSE)
if(bodies EQUAL -1 OR end EQUAL -1)
    message(FATAL_ERROR "${IN}: this flatc writes another form; find where the bodies of UnPack begin")
endif()
math(EXPR length "${end} - ${bodies}")
string(SUBSTRING "${text}" 0 ${bodies} declarations)
string(SUBSTRING "${text}" ${bodies} ${length} definitions)
string(SUBSTRING "${text}" ${end} -1 closing)
string(REPLACE "\ninline " "\n" definitions "${definitions}")
file(WRITE ${HEADER} "${declarations}${closing}")
file(WRITE ${SOURCE} "#include \"protocol/messages_generated.h\"\n\nnamespace raynest::wire {\n${definitions}\n}\n")
