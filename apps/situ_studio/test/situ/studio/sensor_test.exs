defmodule Situ.Studio.SensorTest do
  # A page of this test uses a real WebSocket. It sends valid and invalid data, also to a slow
  # pipeline.
  use ExUnit.Case, async: true

  alias Situ.{AudioBuffer, AudioFormat, EncodedImage}
  alias Situ.Studio.Sensor
  alias Situ.Studio.Sensor.Inbox
  import Situ.Studio.Test.SensorPage

  @moduletag :capture_log

  setup context do
    name = "sensor-#{System.unique_integer([:positive])}"
    {:ok, studio} = Situ.Studio.start_link(port: 0, id: name)
    me = self()

    {:ok, pipeline} =
      Situ.Pipeline.start(fn p ->
        sensor = Sensor.open(p, page: name)

        slow =
          if context[:slow],
            do: fn _ -> receive(do: (:never -> :ok)) end,
            else: &send(me, {:video, &1, &2.originating_time})

        Situ.each(sensor.video, slow, async: true, policy: Situ.Delivery.throttle(2))
        Situ.each(sensor.audio, &send(me, {:audio, &1, &2.originating_time}))
        Situ.each(sensor.clock, &send(me, {:clock, &1}))
        tone = Situ.map(sensor.audio, & &1, type: AudioBuffer)
        Sensor.Speaker.play(tone, page: name)
      end)

    on_exit(fn -> Situ.Pipeline.stop(pipeline, timeout: 1_000) end)
    poll(fn -> Inbox.fetch_sensor(Sensor, name) != :error end)
    %{port: Situ.Studio.port(studio), name: name, pipeline: pipeline}
  end

  defp camera(port, name), do: connect(port, "/sensor/socket?name=#{name}")

  @jpeg <<0xFF, 0xD8, 0xFF, 0xE0, 0::128, 0xFF, 0xD9>>

  defp picture(ms), do: <<1, 0::24, 64::little-16, 48::little-16, ms::little-float-64>> <> @jpeg

  defp sound(ms, samples),
    do:
      <<2, 0::24, 48_000::little-32, ms::little-float-64>> <>
        for(s <- samples, into: "", do: <<s::little-signed-16>>)

  test "compares clocks, receives images and audio at their times, and sends audio", context do
    {"HTTP/1.1 101" <> _, socket} = camera(context.port, context.name)
    assert json(socket) == %{"credit" => 2}
    text(socket, %{ping: 5})
    assert %{"pong" => 5, "now" => now} = json(socket)
    assert abs(now - now_ms()) < 60_000
    # An image that arrives before the clocks are compared has no time.
    push(socket, 2, picture(now))
    text(socket, %{offset: 1_000})
    assert_receive {:clock, 1_000.0}
    ms = now_ms()
    push(socket, 2, picture(ms))

    assert_receive {:video, %EncodedImage{format: :jpeg, width: 64, height: 48, data: @jpeg},
                    time}

    assert_in_delta time, (ms - 1_000) * 1_000_000, 1_000
    push(socket, 2, sound(ms, [1, -2, 300]))
    assert_receive {:audio, buffer, ^time}

    assert buffer.format == AudioFormat.pcm(48_000) and
             AudioBuffer.to_samples(buffer) == [1, -2, 300]

    assert json(socket) == %{"credit" => 1}

    assert played(socket) ==
             <<3, 0::24, 48_000::little-32, 1::little-16, -2::little-signed-16, 300::little-16>>
  end

  defp played(socket) do
    case pull(socket) do
      {2, bytes} -> bytes
      {_, _} -> played(socket)
    end
  end

  @tag :slow
  test "a pipeline that does not take images grants the page no more credit", context do
    {_, socket} = camera(context.port, context.name)
    assert json(socket) == %{"credit" => 2}
    text(socket, %{offset: 0})
    ms = now_ms()
    for i <- 1..50, do: push(socket, 2, picture(ms + i))
    for i <- 1..900, do: push(socket, 2, sound(ms + i, [1]))
    text(socket, %{ping: 1})

    # The handler replies to the ping after all earlier frames. The sensor must still process
    # them.
    before = credits(socket, 0)
    {:ok, sensor} = Inbox.fetch_sensor(Sensor, context.name)
    poll(fn -> Process.info(sensor, :message_queue_len) == {:message_queue_len, 0} end)
    text(socket, %{ping: 1})
    assert before + credits(socket, 0) < 20
  end

  defp credits(socket, n) do
    case json(socket) do
      %{"credit" => more} -> credits(socket, n + more)
      %{"pong" => _} -> n
    end
  end

  test "accepts one page for a sensor, and another after invalid bytes ended the connection",
       context do
    {_, nobody} = camera(context.port, "nobody")
    assert {8, <<1008::16, "no pipeline" <> _>>} = pull(nobody)
    {"HTTP/1.1 101" <> _, socket} = camera(context.port, context.name)
    assert json(socket) == %{"credit" => 2}
    {_, second} = camera(context.port, context.name)
    assert {8, <<1008::16, "another page" <> _>>} = pull(second)
    text(socket, %{offset: 0})

    bad = [
      {1, "no json"},
      {1, ~s({"offset": "x"})},
      {2, "xyz"},
      {2, picture(now_ms()) |> String.replace(@jpeg, "no jpeg")},
      {2, picture(0.0)},
      {2, <<2, 0::24, 1::little-32, now_ms()::little-float-64, 0, 0>>},
      {2, <<1, 0::24, 1::little-16, 1::little-16, -1::64>> <> @jpeg}
    ]

    :gen_tcp.close(socket)

    for {opcode, data} <- bad do
      socket = reconnect(context)
      text(socket, %{offset: 0})
      push(socket, opcode, data)
      assert closed?(socket), inspect(data)
      :gen_tcp.close(socket)
    end

    socket = reconnect(context)
    text(socket, %{offset: 0})
    push(socket, 2, picture(now_ms()))
    assert_receive {:video, _, _}
  end

  defp reconnect(context) do
    {{1, _credit}, socket} = again(fn -> camera(context.port, context.name) end)
    socket
  end

  test "refuses viewers on every sensor's socket", context do
    owner = "the-token-of-owners"
    viewer = "the-token-of-viewers"
    opts = [port: 0, id: context.name <> "-shared", token: owner, viewer_token: viewer]
    {:ok, studio} = Situ.Studio.start_link(opts)
    port = Situ.Studio.port(studio)
    bearer = fn token -> [{"Authorization", "Bearer #{token}"}] end
    path = "/sensor/socket?name=#{context.name}"

    for path <- [path, "/headset/socket?name=headset"] do
      {"HTTP/1.1 101" <> _, socket} = connect(port, path, bearer.(viewer))
      assert {8, <<1008::16, "a view-only link cannot be a sensor">>} = pull(socket)
      {"HTTP/1.1 401" <> _, _} = connect(port, path, [])
    end

    # Neither attempt occupied the sensor, so its owner can connect.
    {_, socket} = connect(port, path, bearer.(owner))
    assert json(socket) == %{"credit" => 2}
    text(socket, %{offset: 0})
    push(socket, 2, picture(now_ms()))
    assert_receive {:video, _, _}
  end

  @tag :tmp_dir
  test "a recording of a camera ends with its page and contains what the page sent", %{
    tmp_dir: tmp,
    test: id
  } do
    id = to_string(id)
    {:ok, studio} = Situ.Studio.start_link(port: 0, path: tmp, id: id)

    assert {:ok, %{page: page, recording: "Camera.0000"}} =
             Situ.Studio.CameraRecording.start_recording(id, tmp)

    poll(fn -> Inbox.fetch_sensor(Sensor, page) != :error end)
    {"HTTP/1.1 101" <> _, socket} = camera(Situ.Studio.port(studio), page)
    assert json(socket) == %{"credit" => 2}
    text(socket, %{offset: 0})
    ms = now_ms()
    push(socket, 2, picture(ms))
    push(socket, 2, sound(ms + 20, [1, 2]))
    push(socket, 2, picture(ms + 33))
    text(socket, %{ping: 1})
    # The answer follows the frames, so the sensor has them when the page leaves.
    credits(socket, 0)
    :gen_tcp.close(socket)
    path = Path.join(tmp, "Camera.0000")
    poll(fn -> match?({:ok, %{live?: false}}, open_info(path)) end)
    store = Situ.Store.open!(path)
    assert Enum.count(Situ.Store.messages(store, "Camera.Pictures")) == 2
    assert [%{data: buffer}] = Enum.to_list(Situ.Store.messages(store, "Camera.Sound"))
    assert AudioBuffer.to_samples(buffer) == [1, 2]
  end

  defp open_info(path) do
    with {:ok, store} <- Situ.Store.open(path), do: {:ok, %{live?: Situ.Store.live?(store)}}
  end
end
