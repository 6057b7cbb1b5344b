defmodule Situ.Examples.RecordedDevicesTest do
  @moduledoc false
  # Records a simulated camera and microphone and plays them back in the studio, which must show the devices' data.
  use ExUnit.Case, async: true

  alias Situ.{AudioBuffer, Image, Time}
  alias Situ.Media.{Camera, Decoder, Microphone}

  @moduletag :tmp_dir
  @talk Path.expand("../../situ_media/test/fixtures/talk1.mp4", __DIR__)
  @device "simulated:" <> @talk

  setup %{tmp_dir: dir} do
    test = self()

    {:ok, pipeline} =
      Situ.Pipeline.start(
        fn p ->
          camera = Camera.open(p, device: @device, size: {64, 32})
          microphone = Microphone.open(p, device: @device)
          store = Situ.Store.create(p, "lobby", dir)
          Situ.Store.write(camera, store, "Lobby.Camera")
          Situ.Store.write(microphone, store, "Lobby.Microphone")
          Situ.each(camera, fn _, message -> send(test, {:camera, message.originating_time}) end)
          Situ.each(microphone, fn _, m -> send(test, {:microphone, m.originating_time}) end)
        end,
        []
      )

    pictures = for _ <- 1..20, do: next(:camera)
    for _ <- 1..50, do: next(:microphone)
    assert {:ok, _} = Situ.Pipeline.stop(pipeline)
    %{pictures: pictures, path: Path.join(dir, "lobby")}
  end

  defp next(stream) do
    receive do
      {^stream, time} -> time
    after
      20_000 -> flunk("no #{stream}")
    end
  end

  test "the studio shows the camera's images and plays the microphone's audio", context do
    {:ok, store} = Situ.Store.open(context.path)
    [{first, %Image{width: 64}} | _] = messages(store, "Lobby.Camera")
    assert first == hd(context.pictures)

    Process.flag(:trap_exit, true)

    {:ok, studio} =
      Situ.Studio.start_link(path: Path.dirname(context.path), port: 0, id: "recorded devices")

    on_exit(fn -> Process.exit(studio, :kill) end)
    item = Situ.Studio.only_item(studio)

    # The tenth image, at its own time.
    time = Enum.at(context.pictures, 9)

    {4, <<64::little-32, 32::little-32, _pixels::little-64, _::binary>>} =
      fetch(studio, "at", source: item, stream: "Lobby.Camera", viz: "image", at: time)

    # Half a second of audio from the start must equal the samples of the file.
    {9, samples} =
      fetch(studio, "pcm",
        source: item,
        stream: "Lobby.Microphone",
        from: first,
        to: first + Time.ms(500)
      )

    heard = for <<v::little-float-32 <- samples>>, do: round(v * 32_768)
    spoken = first_samples(length(heard))
    assert length(heard) >= 7_500
    assert Enum.zip_with(heard, spoken, &abs(&1 - &2)) |> Enum.max() <= 1
  end

  defp messages(store, name) do
    store
    |> Situ.Store.messages(name)
    |> Enum.map(&{&1.originating_time, &1.data})
  end

  # One frame of a response: its kind and its payload.
  defp fetch(studio, what, query) do
    {:ok, _} = Application.ensure_all_started(:inets)

    url =
      Situ.Studio.url(studio)
      |> URI.merge("/data/#{what}?" <> URI.encode_query(query))
      |> to_string()

    {:ok, {{_, 200, _}, _, body}} =
      :httpc.request(:get, {String.to_charlist(url), []}, [timeout: 20_000], body_format: :binary)

    <<_header::binary-size(40), kind::little-16, _::48, bytes::little-32, _::binary-size(20),
      payload::binary-size(bytes), _::binary>> = body

    {kind, payload}
  end

  defp first_samples(count) do
    {:ok, decoder} = Decoder.open(@talk, video: false)
    samples(decoder, count, [])
  end

  defp samples(decoder, count, parts) when count <= 0 do
    Decoder.close(decoder)
    parts |> Enum.reverse() |> Enum.concat()
  end

  defp samples(decoder, count, parts) do
    {:audio, _, buffer, decoder} = Decoder.next_item(decoder)

    samples(decoder, count - AudioBuffer.frame_count(buffer), [
      AudioBuffer.to_samples(buffer) | parts
    ])
  end
end
