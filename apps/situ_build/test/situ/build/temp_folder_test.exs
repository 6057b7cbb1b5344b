defmodule Situ.Build.TempFolderTest do
  # Only Situ.TempFolder gives temporary files random names in folders that are closed to other users.
  use ExUnit.Case, async: true

  @root Path.expand("../../../../..", __DIR__)
  # Exceptions: Situ.TempFolder itself, in-memory stores (other processes look for their name), and sockets (paths must
  # be short).
  @homes ~w(situ_types/lib/situ/temp_folder.ex situ_store/lib/situ/store/memory_stores.ex) ++
           ~w(situ_media/lib/situ/media/ffmpeg/socket.ex)

  test "only Situ.TempFolder creates files in the system's temporary folder" do
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
