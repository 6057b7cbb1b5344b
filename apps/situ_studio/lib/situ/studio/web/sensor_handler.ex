defmodule Situ.Studio.Web.SensorHandler do
  @moduledoc false
  # Handles the connection of a page that acts as a sensor. Text frames are JSON: `ping`, `offset` and `drawn` from
  # the page, `pong` and `credit` to the page. Binary frames begin with their kind (`Situ.Studio.FrameSchema`). Frames
  # from the page contain its time and are parsed by the sensor (`Situ.Studio.Sensor.Packet`): images, audio and
  # samples of a headset. Frames to the page are audio to play and scenes to draw.
  #
  # One WebSocket carries JPEG images and PCM audio. WebRTC would need ICE, DTLS-SRTP and codecs
  # for one hop on a local network, and MediaRecorder has seconds of delay and no times of single
  # images. The cost is about 2 MB/s for 30 images of 640x480 a second.
  @behaviour Situ.Live.SocketHandler

  alias Situ.JSON
  alias Situ.Studio.FrameSchema
  alias Situ.Studio.Headset.Display
  alias Situ.Studio.Sensor.Inbox

  @speaker FrameSchema.code(:device, :speaker)

  # Times and clock offsets from the page must be within a day of the server's clock.
  @day_ms 86_400_000

  @impl true
  def init(%{role: :viewer}, _kind), do: {:error, "a view-only link cannot be a sensor"}

  def init(request, kind) do
    name = request.query["name"] || "page"

    with {:sensor, {:ok, sensor}} <- {:sensor, Inbox.fetch_sensor(kind, name)},
         :ok <- Inbox.register_page(kind, name, sensor) do
      Process.monitor(sensor)
      Display.notify_page_opened(kind, name)
      {:ok, %{kind: kind, sensor: sensor, offset: nil, drawing: %{}}}
    else
      {:sensor, :error} -> {:error, "no pipeline has a sensor of this name"}
      :error -> {:error, "another page is already this sensor"}
    end
  end

  @impl true
  def handle_in({text, opcode: :text}, state) do
    case JSON.decode(text) do
      {:ok, %{"ping" => sent}} when is_number(sent) ->
        {:push, text_frame(%{pong: sent, now: System.os_time(:microsecond) / 1_000}), state}

      {:ok, %{"offset" => ms}} when is_number(ms) and abs(ms) < @day_ms ->
        send(state.sensor, {:sensor, :clock, Situ.Time.now(), ms / 1})
        {:ok, %{state | offset: ms}}

      {:ok, %{"drawn" => layer}} ->
        finish_drawing(state, layer)

      _ ->
        {:stop, {:shutdown, :bad_request}, state}
    end
  end

  # Until the clocks have been compared, the page's times are meaningless.
  def handle_in({_bytes, opcode: :binary}, %{offset: nil} = state), do: {:ok, state}

  def handle_in({bytes, opcode: :binary}, state) do
    with {ms, outputs} <- state.kind.parse(bytes),
         time = round((ms - state.offset) * 1_000_000),
         true <- abs(time - Situ.Time.now()) < @day_ms * 1_000_000 do
      for {output, data} <- outputs, do: send(state.sensor, {:sensor, output, time, data})
      {:ok, state}
    else
      _ -> {:stop, {:shutdown, :bad_request}, state}
    end
  end

  @impl true
  def handle_info({:credit, n}, state), do: {:push, text_frame(%{credit: n}), state}

  def handle_info({:play, rate, pcm}, state) do
    head = FrameSchema.encode(:speaker, %{kind: @speaker, rate: rate})
    {:push, {:binary, [head, pcm]}, state}
  end

  # At most one scene of a layer is in flight. Newer scenes replace each other until the page has drawn that one.
  def handle_info({:draw, layer, frame}, %{drawing: drawing} = state) do
    if is_map_key(drawing, layer),
      do: {:ok, %{state | drawing: %{drawing | layer => frame}}},
      else: {:push, {:binary, frame}, %{state | drawing: Map.put(drawing, layer, nil)}}
  end

  def handle_info({:DOWN, _, :process, _, _}, state),
    do: {:stop, {:shutdown, :sensor_ended}, state}

  def handle_info(:sensor_ended, state), do: {:stop, {:shutdown, :sensor_ended}, state}
  def handle_info(_other, state), do: {:ok, state}

  defp finish_drawing(%{drawing: drawing} = state, layer) do
    case drawing do
      %{^layer => nil} ->
        {:ok, %{state | drawing: Map.delete(drawing, layer)}}

      %{^layer => frame} ->
        {:push, {:binary, frame}, %{state | drawing: %{drawing | layer => nil}}}

      _ ->
        {:stop, {:shutdown, :bad_request}, state}
    end
  end

  defp text_frame(map), do: {:text, JSON.encode(map)}
end
