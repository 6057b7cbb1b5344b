defmodule Situ.Build.ScratchTest do
  # One home for temporary files: their names are random and their folders closed there, and nowhere else.
  use ExUnit.Case, async: true

  @root Path.expand("../../../../..", __DIR__)
  # It makes them; a socket's path must be short; stores in memory have a name that others look for.
  @homes ~w(situ_types/lib/situ/scratch.ex situ_store/lib/situ/store/volatile.ex) ++
           ~w(situ_media/lib/situ/media/ffmpeg/socket.ex)

  test "only Situ.Scratch makes files in the system's temporary folder" do
    files = Path.wildcard(Path.join(@root, "apps/*/lib/**/*.ex"))
    assert length(files) > 500

    others =
      for file <- files,
          not String.ends_with?(file, @homes),
          {line, n} <- file |> File.stream!() |> Enum.with_index(1),
          line =~ "tmp_dir" and not (line =~ "iex>"),
          do: "#{Path.relative_to(file, @root)}:#{n}"

    assert others == []
  end
end
