defmodule Situ.Studio.Web.VideoHttpTest do
  use ExUnit.Case, async: true
  alias Situ.Live.Request
  alias Situ.Studio.{CodedStreams, Recordings}
  alias Situ.Studio.Recordings.{Adapted, DerivedStreams, Session}
  alias Situ.Studio.Web.VideoHttp

  @moduletag :tmp_dir

  defmodule Unchanged do
    @behaviour Situ.Studio.Adapter
    @impl true
    def about, do: %{}
    @impl true
    def adapt(data, _message), do: {:ok, data}
  end

  setup %{tmp_dir: folder} do
    path = Path.join(folder, "film.mp4")

    {_, 0} =
      System.cmd(
        "ffmpeg",
        ~w(-v error -y -f lavfi -i testsrc2=size=64x48:rate=25:duration=1 -c:v libx264) ++
          ~w(-pix_fmt yuv420p -bf 2 #{path})
      )

    {:ok, path: path}
  end

  defp start_studio(folder) do
    id = "video-#{System.unique_integer([:positive])}"
    start_supervised!({Situ.Studio, id: id, path: folder, port: 0})
    id
  end

  defp get(studio, what, query) do
    request = %Request{method: "GET", path: "/data/video", query: query}
    VideoHttp.call(request, {studio, what})
  end

  defp index(studio, query) do
    {:ok, map} = studio |> get(:index, query) |> Map.fetch!(:body) |> Situ.JSON.decode()
    map
  end

  test "a page gets the index and the packets of a film", %{tmp_dir: folder} do
    studio = start_studio(folder)
    film = %{"source" => "film.mp4", "stream" => "Video"}
    described = index(studio, film)

    assert %{"codec" => "avc1." <> _, "count" => 25, "width" => 64, "rotation" => 0} = described
    columns = described["packets"] |> Base.decode64!() |> :zlib.uncompress()
    <<_steps::binary-size(200), sizes::binary-size(100), flags::binary-size(25)>> = columns
    assert match?(<<1, _::binary>>, flags)

    packets = get(studio, :packets, Map.merge(film, %{"first" => "0", "count" => "25"}))
    total = Enum.sum(for <<size::little-32 <- sizes>>, do: size)
    assert {packets.status, IO.iodata_length(packets.body)} == {200, total}

    for {first, count} <- [{"-1", "1"}, {"0", "0"}, {"x", "1"}, {"0", "100001"}] do
      query = Map.merge(film, %{"first" => first, "count" => count})
      assert get(studio, :packets, query).status == 400
    end

    query = Map.merge(film, %{"first" => "20", "count" => "9"})
    assert get(studio, :packets, query).status == 422
    assert get(studio, :index, %{film | "source" => "none.mp4"}).status == 404
    assert get(studio, :index, %{film | "stream" => %{"a" => "b"}}).status == 400
  end

  test "streams without compressed images have no codec", %{tmp_dir: folder} do
    studio = start_studio(folder)
    {:ok, writer} = Situ.Store.Writer.create("plain", folder)
    {:ok, out} = Situ.Store.Writer.stream(writer, "Level", type: :float)
    {:ok, out} = Situ.Store.Writer.append(out, [%Situ.Message{data: 1.0, originating_time: 5}])
    {:ok, _} = Situ.Store.Writer.close_stream(out, 9)
    :ok = Situ.Store.Writer.close(writer)
    query = %{"source" => "plain.0000", "stream" => "Level"}
    assert index(studio, query) == %{"codec" => nil}

    query = Map.merge(query, %{"first" => "0", "count" => "1"})
    assert get(studio, :packets, query).status == 422
    assert get(studio, :packets, Map.put(query, "small", "1")).status == 400
  end

  test "a session and a comparison pass the images on, at their own times", %{path: path} do
    {:ok, film} = Recordings.Store.open(path)
    {:ok, video} = CodedStreams.fetch(film, "Video")
    session = DerivedStreams.wrap(Session.combine([{"Room.", film}, {"Desk.", film}]))
    assert CodedStreams.fetch(session, "Room.Video") == {:ok, video}
    assert {:ok, [_, _]} = CodedStreams.read_packets(session, "Desk.Video", 3, 2)

    both = DerivedStreams.wrap(Recordings.Comparison.combine_recordings(film, film, 700))
    {:ok, moved} = CodedStreams.fetch(both, "Compared.Video")
    times = &(&1 |> Situ.Recording.CodedVideo.list_packets() |> Enum.map(fn p -> elem(p, 0) end))
    assert times.(moved) == Enum.map(times.(video), &(&1 + 700))
    assert CodedStreams.fetch(both, "Video") == {:ok, video}
  end

  test "images that are computed are not passed on", %{path: path} do
    {:ok, film} = Recordings.Store.open(path)
    assert CodedStreams.fetch(Adapted.wrap(film, Unchanged), "Video") == :none
    assert CodedStreams.read_packets(Adapted.wrap(film, Unchanged), "Video", 0, 1) == :none
    assert CodedStreams.fetch(DerivedStreams.wrap(film), "= Video.width * 2") == :none
  end
end
