defmodule Situ.Media.HostileNamesTest do
  # File names that FFmpeg would interpret as options, protocols or devices. Not async: the current folder is global.
  use ExUnit.Case, async: false
  alias Situ.Media.{Encoder, FileInfo}
  alias Situ.Store

  @moduletag :tmp_dir
  @secret "secret.mp4"

  # Each is the name of a plain file. Names that contain another name lead to that file if FFmpeg interprets them.
  @names ["-i.mp4", "-y", "http:127.0.0.1.mp4", "subfile,,start,0,end,0,,:secret.mp4"] ++
           ["concat:secret.mp4|secret.mp4", "$(touch RAN).mp4"]

  setup %{tmp_dir: root} do
    file = Path.join(root, @secret)

    {_, 0} =
      System.cmd(
        "ffmpeg",
        ~w(-v error -f lavfi -i testsrc=size=16x16:rate=5:duration=0.4 -c:v mpeg4 #{file})
      )

    :ok
  end

  defp pictures(name) do
    {:ok, store} = Store.open(name)
    store |> Store.messages("Video") |> Enum.map(& &1.data)
  end

  test "treats them as file names only", %{tmp_dir: root} do
    File.cd!(root, fn ->
      for name <- @names do
        assert {:error, %{code: :no_file}} = FileInfo.read(name)
        File.cp!(@secret, name)
        assert {:ok, %FileInfo{video: %{width: 16}, name: ^name}} = FileInfo.read(name)
        File.rm!(name)
      end

      assert File.ls!(".") == [@secret]
    end)
  end

  test "reads images from such a file and writes them to one", %{tmp_dir: root} do
    File.cd!(root, fn ->
      File.cp!(@secret, "concat:in.mp4")
      [picture | _] = pictures("concat:in.mp4")
      name = "concat:-out.mp4"
      {:ok, encoder} = Encoder.open(name, video: picture, start_time: 0)
      for i <- 0..2, do: assert(Encoder.video(encoder, i * 100_000_000, picture) == :ok)
      assert Encoder.close(encoder) == :ok
      assert {:ok, %{video: %{width: 16}}} = FileInfo.read(name)
    end)
  end
end
