# Only some programs need OpenCV; bin/setup --with opencv builds it.
without =
  case Situ.Space.OpenCV.fetch_program() do
    {:ok, _} ->
      []

    {:error, error} ->
      IO.puts("Not tested: chessboards and stereo. " <> Exception.message(error))
      [:opencv]
  end

without =
  if Situ.Space.DepthCamera.Library.available?() do
    without
  else
    IO.puts(
      "Not tested: depth cameras by libraries, for want of depth_port (bin/setup --with depth)"
    )

    [:depth_port | without]
  end

# A busy machine may deliver an expected message late; a missing message still fails the test.
ExUnit.start(exclude: without, assert_receive_timeout: 30_000, timeout: 120_000)
