"""OpenEXR files: their headers, and the pixels of scan-line blocks, read and written.

`reader.ExrFile` opens a file once, and is the only code that opens one with OpenEXR or OpenImageIO.
`header` parses headers, parts and channels, and `scanlines` decodes ZIP and ZIPS. `writer` lists
what a generated frame takes over from its key frame, and encodes it.
Every other compression is decoded by OpenImageIO and encoded by OpenEXR.

The words are those of "OpenEXR File Layout" (https://openexr.com/en/latest/OpenEXRFileLayout.html):

chunk offset table
    For each chunk of a part, where it begins in the file. It follows the headers.
scan-line block
    A chunk: the number of its first line, its size, and 1 (ZIPS) or 16 (ZIP) compressed lines.
interleave
    A block's bytes are deflated as all even ones before all odd ones; reading interleaves them.
predictor
    Each of these bytes is stored as its difference to the byte before, plus 128.
"""
