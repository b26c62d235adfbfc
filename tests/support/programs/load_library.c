/*
 * Load the DLL of argument 1 and look up the symbols of the other arguments: prints "loaded" if
 * all are there.
 */
#include <stdio.h>
#include <windows.h>

int main(int argc, char **argv)
{
    const HMODULE library = argc > 2 ? LoadLibraryA(argv[1]) : NULL;
    if (library == NULL) {
        printf("not loaded: error %lu\n", GetLastError());
        return 1;
    }
    for (int k = 2; k < argc; ++k) {
        if (GetProcAddress(library, argv[k]) == NULL) {
            printf("missing: %s\n", argv[k]);
            return 1;
        }
    }
    printf("loaded\n");
    return FreeLibrary(library) ? 0 : 1;
}
