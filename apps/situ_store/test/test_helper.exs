# Only object storage needs this program; bin/setup --with s3 builds it.
without =
  if Situ.Store.S3.Program.available?() do
    []
  else
    IO.puts("Not tested: object storage, for want of object_port (bin/setup --with s3)")
    [:object_port]
  end

# A busy machine may deliver an expected message late; a missing message still fails the test.
ExUnit.start(exclude: without, assert_receive_timeout: 30_000, timeout: 120_000)
