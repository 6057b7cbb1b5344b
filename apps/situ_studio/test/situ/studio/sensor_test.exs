defmodule Situ.Studio.SensorTest do
  # A page of the test's own, over a real WebSocket: what it sends, well and badly, and what a slow pipeline does to it.
  use ExUnit.Case, async: true

  alias Situ.{AudioBuffer, AudioFormat, EncodedImage, JSON}
  alias Situ.Studio.Sensor

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
    poll(fn -> Sensor.find(name) != :error end)
    %{port: Situ.Studio.port(studio), name: name, pipeline: pipeline}
  end

  defp poll(fun) do
    unless fun.() do
      receive do
      after
        20 -> poll(fun)
      end
    end
  end

  # A small WebSocket client: frames are masked, as a browser's are.
  defp connect(port, name) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])

    :ok =
      :gen_tcp.send(socket, [
        "GET /sensor/socket?name=#{name} HTTP/1.1\r\nHost: 127.0.0.1:#{port}\r\nOrigin: http://127.0.0.1:#{port}\r\n",
        "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
      ])

    {:ok, head} = read_head(socket, "")
    {head, socket}
  end

  defp read_head(socket, got) do
    if String.ends_with?(got, "\r\n\r\n") do
      {:ok, got}
    else
      {:ok, byte} = :gen_tcp.recv(socket, 1, 30_000)
      read_head(socket, got <> byte)
    end
  end

  defp push(socket, opcode, data) do
    length =
      if byte_size(data) < 126,
        do: <<1::1, byte_size(data)::7>>,
        else: <<1::1, 126::7, byte_size(data)::16>>

    :gen_tcp.send(socket, [<<1::1, 0::3, opcode::4>>, length, <<0::32>>, data])
  end

  defp text(socket, map), do: push(socket, 1, JSON.encode(map))

  defp pull(socket) do
    with {:ok, <<_::4, opcode::4, 0::1, length::7>>} <- :gen_tcp.recv(socket, 2, 30_000),
         {:ok, length} <- length(socket, length),
         {:ok, data} <-
           if(length == 0, do: {:ok, ""}, else: :gen_tcp.recv(socket, length, 30_000)),
         do: {opcode, data}
  end

  defp length(socket, 126) do
    {:ok, <<n::16>>} = :gen_tcp.recv(socket, 2, 30_000)
    {:ok, n}
  end

  defp length(_socket, n), do: {:ok, n}

  defp json(socket) do
    case pull(socket) do
      {1, text} -> text |> JSON.decode() |> elem(1)
      {_, _} -> json(socket)
    end
  end

  @jpeg <<0xFF, 0xD8, 0xFF, 0xE0, 0::128, 0xFF, 0xD9>>

  defp picture(ms), do: <<1, 0::24, 64::little-16, 48::little-16, ms::little-float-64>> <> @jpeg

  defp sound(ms, samples),
    do:
      <<2, 0::24, 48_000::little-32, ms::little-float-64>> <>
        for(s <- samples, into: "", do: <<s::little-signed-16>>)

  defp now_ms, do: System.os_time(:microsecond) / 1_000

  test "clocks are compared, pictures and sound come at their times, sound goes back", context do
    {"HTTP/1.1 101" <> _, socket} = connect(context.port, context.name)
    assert json(socket) == %{"credit" => 2}
    text(socket, %{ping: 5})
    assert %{"pong" => 5, "now" => now} = json(socket)
    assert abs(now - now_ms()) < 60_000
    # A picture that comes before the clocks are compared has no time.
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
  test "a pipeline that does not take pictures gives the page no leave for more", context do
    {_, socket} = connect(context.port, context.name)
    assert json(socket) == %{"credit" => 2}
    text(socket, %{offset: 0})
    ms = now_ms()
    for i <- 1..50, do: push(socket, 2, picture(ms + i))
    for i <- 1..900, do: push(socket, 2, sound(ms + i, [1]))
    text(socket, %{ping: 1})

    # The handler answers the ping after all earlier frames; then the sensor still has to take them.
    before = credits(socket, 0)
    {:ok, sensor} = Sensor.find(context.name)
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

  test "one page for a sensor; bytes that are none of it end the connection, and the next page may come",
       context do
    {_, nobody} = connect(context.port, "nobody")
    assert {8, <<1008::16, "no pipeline" <> _>>} = pull(nobody)
    {"HTTP/1.1 101" <> _, socket} = connect(context.port, context.name)
    assert json(socket) == %{"credit" => 2}
    {_, second} = connect(context.port, context.name)
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

  # The page before may not have gone yet.
  defp reconnect(context) do
    {_, socket} = connect(context.port, context.name)

    case pull(socket) do
      {1, _credit} ->
        socket

      {8, _} ->
        receive do
        after
          20 -> reconnect(context)
        end
    end
  end

  defp closed?(socket) do
    case pull(socket) do
      {8, _} -> true
      {:error, _} -> true
      {_, _} -> closed?(socket)
    end
  end
end
