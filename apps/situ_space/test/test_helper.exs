# Only some programs need it; bin/setup --with opencv builds it.
without =
  case Situ.Space.OpenCV.program() do
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

# A busy machine may deliver an expected message late; a missing one fails the test all the same.
ExUnit.start(exclude: without, assert_receive_timeout: 30_000, timeout: 120_000)
