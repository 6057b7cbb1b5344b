defmodule Situ.Studio.UploadTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  import Situ.Studio.Test.SensorPage
  alias Situ.Store.Writer
  alias Situ.Studio.{Stores, Upload}

  @moduletag :tmp_dir
  @csv "time,x\n2026-01-01T00:00:00Z,1\n2026-01-01T00:00:01Z,2\n"

  defp send_all(upload, bytes, chunk) when byte_size(bytes) > chunk do
    <<head::binary-size(chunk), rest::binary>> = bytes
    {:ok, upload} = Upload.write(upload, head)
    send_all(upload, rest, chunk)
  end

  defp send_all(upload, bytes, _chunk) do
    {:ok, upload} = Upload.write(upload, bytes)
    upload
  end

  # Returns the files of a folder with their contents, as an upload takes them.
  defp read_folder(path) do
    for file <- Enum.sort(File.ls!(path)),
        do: {Path.join(Path.basename(path), file), File.read!(Path.join(path, file))}
  end

  defp sizes(files), do: for({path, bytes} <- files, do: {path, byte_size(bytes)})
  defp bytes(files), do: for({_, bytes} <- files, into: "", do: bytes)

  property "a folder arrives as it was, whatever the sizes of its files and of the chunks",
    numtests: 60,
    context: %{tmp_dir: tmp} do
    forall {contents, chunk} <- {list(binary()), integer(1, 40)} do
      folder = Path.join(tmp, "p#{System.unique_integer([:positive])}")
      File.mkdir_p!(folder)
      extra = for {bytes, i} <- Enum.with_index(contents), do: {"Set/deep/#{i}.bin", bytes}
      files = [{"Set/walk.csv", @csv} | extra]
      {:ok, upload} = Upload.start(folder, "Set", sizes(files))
      upload = send_all(upload, bytes(files), chunk)
      assert Upload.complete?(upload)
      assert upload.received == byte_size(bytes(files))
      assert Upload.finish(upload) == {:ok, "Set"}
      assert File.ls!(folder) == ["Set"]
      for {path, bytes} <- files, do: assert(File.read!(Path.join(folder, path)) == bytes)
      {:error, %{code: :bad_upload}} = Upload.write(upload, "x")
    end
  end

  test "a recorded folder can be opened afterwards, but is not listed before", %{tmp_dir: tmp} do
    from = Path.join(tmp, "from")
    File.mkdir_p!(from)
    {:ok, writer} = Writer.create("Talk", from)
    {:ok, _} = Writer.stream(writer, "Level", type: :float)
    :ok = Writer.close(writer)
    files = read_folder(writer.path)
    folder = Path.join(tmp, "to")
    File.mkdir_p!(folder)
    {:ok, upload} = Upload.start(folder, "Talk.0000", sizes(files))
    upload = send_all(upload, bytes(files), 1_000)
    assert Stores.list_recordings(folder) == []
    assert {:ok, "Talk.0000"} = Upload.finish(upload)
    assert [{"Talk.0000", _}] = Stores.list_recordings(folder)
    assert {:error, %{code: :exists}} = Upload.start(folder, "Talk.0000", sizes(files))
  end

  test "names of downloads are adapted", %{tmp_dir: tmp} do
    for {name, clean} <- [
          {"walk (1).csv", "walk -1-.csv"},
          {"[é] Überblick #2.csv", "é- Überblick -2.csv"},
          {String.duplicate("a", 100) <> ".csv", String.duplicate("a", 56) <> ".csv"}
        ] do
      {:ok, upload} = Upload.start(tmp, name, [{name, byte_size(@csv)}])
      assert upload |> send_all(@csv, 9) |> Upload.finish() == {:ok, clean}
      assert File.read!(Path.join(tmp, clean)) == @csv
    end
  end

  test "what is no recording is refused with a reason, and leaves nothing", %{tmp_dir: tmp} do
    assert {:error, %{code: :unknown_format, what: "the studio cannot open notes.txt"}} =
             Upload.start(tmp, "notes.txt", [{"notes.txt", 3}])

    for {name, files} <- [
          {"a/b.csv", [{"a/b.csv", 1}]},
          {"..", [{"../x.csv", 1}]},
          {"x.csv", [{"y.csv", 1}]},
          {"Set", [{"Set/../../x.csv", 1}, {"Set/y", 1}]},
          {"Set", [{"Set/a\0b", 1}, {"Set/y", 1}]},
          {"Set", [{"/Set/x", 1}, {"Set/y", 1}]},
          {"Set", [{"Set/x", -1}, {"Set/y", 1}]},
          {"Set", []}
        ] do
      assert {:error, %{code: code}} = Upload.start(tmp, name, files)
      assert code in [:bad_name, :bad_upload], inspect({name, files})
    end

    {:ok, upload} = Upload.start(tmp, "film.mp4", [{"film.mp4", 5}])
    upload = send_all(upload, "hello", 5)
    assert {:error, %{what: "film.mp4 cannot be opened", why: why}} = Upload.finish(upload)
    refute why =~ "situ-upload"
    Upload.discard(upload)

    {:ok, upload} = Upload.start(tmp, "Set", [{"Set/a.txt", 1}, {"Set/b.txt", 1}])
    assert {:error, %{code: :not_found}} = upload |> send_all("ab", 2) |> Upload.finish()
    Upload.discard(upload)
    assert File.ls!(tmp) == []
  end

  describe "over a connection" do
    defp connect_page(port, opts \\ []) do
      {"HTTP/1.1 101" <> _, socket} = connect(port, "/upload/socket", opts)
      socket
    end

    test "a page uploads a file, and a page that leaves deletes its part", %{
      tmp_dir: tmp,
      test: id
    } do
      {:ok, studio} = Situ.Studio.start_link(port: 0, path: tmp, id: to_string(id))
      port = Situ.Studio.port(studio)
      socket = connect_page(port)
      text(socket, %{name: "walk.csv", files: [%{path: "walk.csv", size: byte_size(@csv)}]})
      assert json(socket) == %{"received" => 0}
      push(socket, 2, binary_part(@csv, 0, 10))
      assert json(socket) == %{"received" => 10}

      # A second page takes the same name, and leaves.
      other = connect_page(port)
      text(other, %{name: "walk.csv", files: [%{path: "walk.csv", size: 100}]})
      assert json(other) == %{"received" => 0}
      assert length(File.ls!(tmp)) == 2
      :gen_tcp.close(other)
      Situ.Test.Eventually.eventually(fn -> length(File.ls!(tmp)) == 1 end)

      push(socket, 2, binary_part(@csv, 10, byte_size(@csv) - 10))
      assert json(socket) == %{"received" => byte_size(@csv)}
      assert json(socket) == %{"done" => "s/walk.csv"}
      assert File.read!(Path.join(tmp, "walk.csv")) == @csv
      assert File.ls!(tmp) == ["walk.csv"]

      text(socket, %{name: "walk.csv", files: [%{path: "walk.csv", size: 1}]})
      assert %{"error" => "walk.csv already exists" <> _} = json(socket)
      text(socket, %{name: 1})
      assert closed?(socket)
    end

    test "viewers, read-only studios and studios without a folder accept nothing", %{
      tmp_dir: tmp,
      test: id
    } do
      viewer = [{"Authorization", "Bearer the-token-of-viewers"}]
      tokens = [token: "the-token-of-owners", viewer_token: "the-token-of-viewers"]

      for {opts, headers, i} <- [
            {[path: tmp] ++ tokens, viewer, 1},
            {[path: tmp, read_only: true], [], 2},
            {[], [], 3}
          ] do
        {:ok, studio} = Situ.Studio.start_link([port: 0, id: "#{id} #{i}"] ++ opts)
        socket = connect_page(Situ.Studio.port(studio), headers)
        assert {8, <<1008::16, "this page may not add recordings">>} = pull(socket)
      end
    end
  end
end
