defmodule Situ.Bridge.Foxglove.SessionTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.Foxglove.{Playback, Session, StoreChannels, Wire}
  alias Situ.{Image, Store}
  doctest Wire

  @moduletag :tmp_dir

  defp decoded(text), do: text |> Situ.JSON.decode() |> elem(1)

  setup context do
    if context[:tmp_dir], do: recorded(context.tmp_dir), else: :ok
  end

  defp recorded(dir) do
    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        store = Store.create(p, "drive", dir)
        values = for i <- 0..99, do: {1_000_000_000 + i * 10_000_000, %{"n" => i}}
        p |> Situ.from_enumerable(values) |> Store.write(store, "Values")
        image = Image.new!(width: 1, height: 1, format: :rgb24, data: <<1, 2, 3>>)

        p
        |> Situ.from_enumerable([{1_500_000_000, image}], type: Image)
        |> Store.write(store, "Camera.Left")
      end)

    {:ok, source: StoreChannels.new(Store.open!(Path.join(dir, "drive")))}
  end

  defp open(source, protocol \\ "foxglove.websocket.v1") do
    {frames, session} = Session.open(source, "test", protocol)
    ops = for {:text, text} <- frames, do: decoded(text)
    %{"channels" => channels} = Enum.find(ops, &(&1["op"] == "advertise"))
    {hd(ops), Map.new(channels, &{&1["topic"], &1}), session}
  end

  defp hear(session, message),
    do: Session.handle_frame(session, {:text, Situ.JSON.encode(message)}, 0)

  defp values(frames),
    do: for({id, time, json} <- data(frames), id == 7, do: {time, decoded(json)["n"]})

  defp data(frames) do
    for {:binary, bytes} <- frames,
        <<1, id::little-32, time::little-64, payload::binary>> <- [IO.iodata_to_binary(bytes)],
        do: {id, time, payload}
  end

  # Ticks every 10 ms from `from` to `to` and collects all frames.
  defp play(session, from, to, frames \\ []) do
    Enum.reduce(from..to//10_000_000, {frames, session}, fn now, {frames, session} ->
      {more, session} = Session.tick(session, now)
      {frames ++ more, session}
    end)
  end

  test "advertises channels with ROS schemas or as JSON", %{source: source} do
    {info, channels, _} = open(source)
    assert info["op"] == "serverInfo"
    refute "playbackControl" in info["capabilities"]
    assert %{"encoding" => "json", "schemaEncoding" => "jsonschema"} = channels["/Values"]
    assert %{"encoding" => "ros1", "schemaName" => "sensor_msgs/Image"} = channels["/Camera/Left"]
  end

  test "sends subscribers all messages once, in order, at playback speed", %{
    source: source
  } do
    {_, channels, session} = open(source)

    {[], session} =
      hear(session, %{
        op: "subscribe",
        subscriptions: [%{id: 7, channelId: channels["/Values"]["id"]}]
      })

    {frames, session} = play(session, 0, 500_000_000)
    assert length(values(frames)) in 50..51
    {frames, _} = play(session, 510_000_000, 1_200_000_000, frames)
    assert values(frames) == for(i <- 0..99, do: {1_000_000_000 + i * 10_000_000, i})
  end

  test "pauses, seeks and changes speed through parameters", %{source: source} do
    {_, channels, session} = open(source)

    {[], session} =
      hear(session, %{
        op: "subscribe",
        subscriptions: [%{id: 7, channelId: channels["/Values"]["id"]}]
      })

    {_, session} = Session.tick(session, 0)

    {_, session} =
      hear(session, %{op: "subscribeParameterUpdates", parameterNames: ["situ.paused"]})

    {[{:text, changed}], session} =
      hear(session, %{op: "setParameters", parameters: [%{name: "situ.paused", value: true}]})

    assert %{"op" => "parameterValues", "parameters" => [%{"value" => true}]} = decoded(changed)

    {frames, session} = play(session, 10_000_000, 200_000_000)
    assert values(frames) == []

    parameters = [
      %{name: "situ.position", value: 0.9},
      %{name: "situ.speed", value: 0.5},
      %{name: "situ.paused", value: false}
    ]

    {frames, session} = hear(session, %{op: "setParameters", parameters: parameters})
    assert values(frames) == [{1_900_000_000, 90}]
    {frames, session} = play(session, 210_000_000, 270_000_000)
    assert values(frames) |> Enum.map(&elem(&1, 1)) == [91, 92, 93]
    {[{:text, text}], _} = hear(session, %{op: "getParameters", parameterNames: [], id: "x"})
    assert %{"id" => "x", "parameters" => [_, %{"value" => 0.5}, _]} = decoded(text)
  end

  test "supports the app's own controls, and reports the end", %{source: source} do
    {info, channels, session} = open(source, "foxglove.sdk.v1")
    assert %{"sec" => 1, "nsec" => 0} = info["dataStartTime"]

    {[], session} =
      hear(session, %{
        op: "subscribe",
        subscriptions: [%{id: 7, channelId: channels["/Values"]["id"]}]
      })

    request = <<3, 0, 2.0::little-float-32, 1, 1_800_000_000::little-64, 2::little-32, "id">>
    {frames, session} = Session.handle_frame(session, {:binary, request}, 0)
    assert values(frames) == [{1_800_000_000, 80}]

    assert {:binary,
            <<5, 0, 1_800_000_000::little-64, 2.0::little-float-32, 1, 2::little-32, "id">>} in frames

    {frames, session} = play(session, 0, 150_000_000)
    assert values(frames) |> Enum.map(&elem(&1, 1)) == Enum.to_list(81..99)
    assert Enum.any?(frames, &match?({:binary, <<5, 3, _::binary>>}, &1))
    # Playing again after the end starts over.
    {first, session} =
      Session.handle_frame(session, {:binary, <<3, 0, 1.0::little-float-32, 0, 0::64, 0::32>>}, 0)

    {frames, _} = play(session, 160_000_000, 300_000_000, first)
    assert [{_, 0}, {_, 1} | _] = values(frames)
  end

  test "does not skip ahead for a client that was idle for long" do
    p = Playback.new(0, 10_000_000_000) |> Playback.advance(0) |> Playback.advance(9_000_000_000)
    assert p.at <= 250_000_000
  end

  test "reports or ignores invalid requests", %{source: source} do
    {_, _, session} = open(source)

    for message <- [
          %{
            op: "subscribe",
            subscriptions: [1, %{id: -1, channelId: 1}, %{id: 1, channelId: "x"}]
          },
          %{op: "advertise", kind: 1},
          %{op: "setParameters", parameters: [%{name: "situ.speed", value: -1}, 3]},
          %{op: "subscribe", subscriptions: 5},
          []
        ] do
      {frames, ^session} = hear(session, message)

      assert frames != [] and
               Enum.all?(frames, fn {:text, text} -> text =~ "status" or text =~ "parameter" end)
    end
  end

  property "survives any bytes" do
    session = %Session{
      source: %StoreChannels{live?: false},
      playback: Playback.new(0, 10),
      sdk?: true
    }

    forall {kind, bytes} <- {one_of([:text, :binary]), binary()} do
      {frames, _} = Session.handle_frame(session, {kind, bytes}, 0)
      assert is_list(frames)
      {frames, _} = Session.handle_frame(session, {:binary, <<3, bytes::binary>>}, 0)
      assert is_list(frames)
    end
  end
end
