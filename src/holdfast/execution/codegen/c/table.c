/* The table of the law in a file of its own: see NAME_load. All numbers there are little-endian. */
static const hf_table *hf_values = 0;
static void *hf_mapped = 0;
static size_t hf_mapped_size = 0;

/* SHA-256 (FIPS 180-4) of a stretch of memory. */
static void hf_digest_block(uint32_t *h, const unsigned char *p) {
    static const uint32_t k[64] = {
        0x428a2f98u, 0x71374491u, 0xb5c0fbcfu, 0xe9b5dba5u, 0x3956c25bu, 0x59f111f1u, 0x923f82a4u,
        0xab1c5ed5u, 0xd807aa98u, 0x12835b01u, 0x243185beu, 0x550c7dc3u, 0x72be5d74u, 0x80deb1feu,
        0x9bdc06a7u, 0xc19bf174u, 0xe49b69c1u, 0xefbe4786u, 0x0fc19dc6u, 0x240ca1ccu, 0x2de92c6fu,
        0x4a7484aau, 0x5cb0a9dcu, 0x76f988dau, 0x983e5152u, 0xa831c66du, 0xb00327c8u, 0xbf597fc7u,
        0xc6e00bf3u, 0xd5a79147u, 0x06ca6351u, 0x14292967u, 0x27b70a85u, 0x2e1b2138u, 0x4d2c6dfcu,
        0x53380d13u, 0x650a7354u, 0x766a0abbu, 0x81c2c92eu, 0x92722c85u, 0xa2bfe8a1u, 0xa81a664bu,
        0xc24b8b70u, 0xc76c51a3u, 0xd192e819u, 0xd6990624u, 0xf40e3585u, 0x106aa070u, 0x19a4c116u,
        0x1e376c08u, 0x2748774cu, 0x34b0bcb5u, 0x391c0cb3u, 0x4ed8aa4au, 0x5b9cca4fu, 0x682e6ff3u,
        0x748f82eeu, 0x78a5636fu, 0x84c87814u, 0x8cc70208u, 0x90befffau, 0xa4506cebu, 0xbef9a3f7u,
        0xc67178f2u};
    uint32_t w[64], s[8];
    for (int i = 0; i < 16; i++)
        w[i] = (uint32_t)p[4 * i] << 24 | (uint32_t)p[4 * i + 1] << 16 |
               (uint32_t)p[4 * i + 2] << 8 | (uint32_t)p[4 * i + 3];
#define HF_TURN(x, n) ((x) >> (n) | (x) << (32 - (n)))
    for (int i = 16; i < 64; i++)
        w[i] = w[i - 16] + w[i - 7] +
               (HF_TURN(w[i - 15], 7) ^ HF_TURN(w[i - 15], 18) ^ w[i - 15] >> 3) +
               (HF_TURN(w[i - 2], 17) ^ HF_TURN(w[i - 2], 19) ^ w[i - 2] >> 10);
    for (int i = 0; i < 8; i++) s[i] = h[i];
    for (int i = 0; i < 64; i++) {
        const uint32_t e = s[4], a = s[0];
        const uint32_t one = s[7] + (HF_TURN(e, 6) ^ HF_TURN(e, 11) ^ HF_TURN(e, 25)) +
                             ((e & s[5]) ^ (~e & s[6])) + k[i] + w[i];
        const uint32_t two = (HF_TURN(a, 2) ^ HF_TURN(a, 13) ^ HF_TURN(a, 22)) +
                             ((a & s[1]) ^ (a & s[2]) ^ (s[1] & s[2]));
        for (int j = 7; j > 0; j--) s[j] = s[j - 1];
        s[4] += one;
        s[0] = one + two;
    }
#undef HF_TURN
    for (int i = 0; i < 8; i++) h[i] += s[i];
}

static int hf_has_digest(const unsigned char *p, size_t size, const unsigned char *digest) {
    uint32_t h[8] = {0x6a09e667u, 0xbb67ae85u, 0x3c6ef372u, 0xa54ff53au,
                     0x510e527fu, 0x9b05688cu, 0x1f83d9abu, 0x5be0cd19u};
    unsigned char end[128] = {0};
    const size_t rest = size % 64, whole = size - rest, blocks = rest < 56 ? 1 : 2;
    for (size_t i = 0; i < whole; i += 64) hf_digest_block(h, p + i);
    if (rest) memcpy(end, p + whole, rest);
    end[rest] = 0x80;
    for (int i = 0; i < 8; i++)
        end[64 * blocks - 1 - (size_t)i] = (unsigned char)((uint64_t)size * 8 >> 8 * i);
    for (size_t i = 0; i < blocks; i++) hf_digest_block(h, end + 64 * i);
    for (int i = 0; i < 32; i++)
        if (digest[i] != (unsigned char)(h[i / 4] >> (24 - 8 * (i % 4)))) return 0;
    return 1;
}

int NAME_use(const void *memory, size_t size) {
    const unsigned char *p = (const unsigned char *)memory;
    const uint32_t mark = 0x01020304u;
    const unsigned char little[4] = {4, 3, 2, 1};
    hf_values = 0;
    if (!p || size < HF_HEADER) return NAME_TABLE_TRUNCATED;
    if (memcmp(p, "HFTABLE\0", 8) != 0) return NAME_TABLE_NONE;
    if (memcmp(&mark, little, 4) != 0) return NAME_TABLE_BYTE_ORDER;
    if (memcmp(p + 8, hf_header + 8, 4) != 0) return NAME_TABLE_VERSION;
    if (memcmp(p, hf_header, HF_HEADER) != 0) return NAME_TABLE_OTHER;
    if (size != HF_HEADER + HF_COUNT * sizeof(hf_table)) return NAME_TABLE_TRUNCATED;
    if ((uintptr_t)p % sizeof(hf_table) != 0) return NAME_TABLE_ALIGNMENT;
    if (!hf_has_digest(p + HF_HEADER, size - HF_HEADER, p + HF_DIGEST)) return NAME_TABLE_DAMAGED;
    hf_values = (const hf_table *)(const void *)(p + HF_HEADER);
    return NAME_TABLE_READY;
}

void NAME_unload(void) {
    hf_values = 0;
#if defined(HF_MAPS)
    if (hf_mapped) munmap(hf_mapped, hf_mapped_size);
#else
    free(hf_mapped);
#endif
    hf_mapped = 0;
    hf_mapped_size = 0;
}

#if defined(NAME_LINKED)
/* Define NAME_LINKED as the path of the table, in quotes: the assembler puts it into the program. */
#define HF_STRING(x) HF_QUOTED(x)
#define HF_QUOTED(x) #x
#if defined(__APPLE__)
__asm__(".const_data\n.balign 64\n_NAME_hf_linked:\n.incbin " HF_STRING(NAME_LINKED)
        "\n_NAME_hf_linked_end:\n.byte 0\n.text\n");
#else
__asm__(".pushsection .rodata\n.balign 64\nNAME_hf_linked:\n.incbin " HF_STRING(NAME_LINKED)
        "\nNAME_hf_linked_end:\n.byte 0\n.popsection\n");
#endif
extern const unsigned char NAME_hf_linked[], NAME_hf_linked_end[];

int NAME_load(const char *path) {
    (void)path;
    return NAME_use(NAME_hf_linked, (size_t)(NAME_hf_linked_end - NAME_hf_linked));
}
#elif defined(HF_MAPS)
int NAME_load(const char *path) {
    struct stat found;
    void *memory;
    int file, status;
    NAME_unload();
    file = open(path, O_RDONLY | O_NONBLOCK); /* a pipe does not keep the program waiting */
    if (file < 0) return NAME_TABLE_NOT_FOUND;
    status = fstat(file, &found) != 0 || !S_ISREG(found.st_mode) ? NAME_TABLE_NONE
             : found.st_size < HF_HEADER                         ? NAME_TABLE_TRUNCATED
                                                                 : NAME_TABLE_READY;
    if (status != NAME_TABLE_READY) {
        close(file);
        return status;
    }
    memory = mmap(0, (size_t)found.st_size, PROT_READ, MAP_PRIVATE, file, 0);
    close(file);
    if (memory == MAP_FAILED) return NAME_TABLE_MEMORY;
    hf_mapped = memory;
    hf_mapped_size = (size_t)found.st_size;
    status = NAME_use(memory, hf_mapped_size);
    if (status != NAME_TABLE_READY) NAME_unload();
    return status;
}
#else
int NAME_load(const char *path) {
    const size_t size = HF_HEADER + HF_COUNT * sizeof(hf_table);
    FILE *file;
    size_t read;
    int status;
    NAME_unload();
    file = fopen(path, "rb");
    if (!file) return NAME_TABLE_NOT_FOUND;
    hf_mapped = malloc(size + 1);
    if (!hf_mapped) {
        fclose(file);
        return NAME_TABLE_MEMORY;
    }
    read = fread(hf_mapped, 1, size + 1, file);
    fclose(file);
    status = NAME_use(hf_mapped, read);
    if (status != NAME_TABLE_READY) NAME_unload();
    return status;
}
#endif
