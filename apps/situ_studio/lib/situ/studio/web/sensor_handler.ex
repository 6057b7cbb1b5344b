defmodule Situ.Studio.Web.SensorHandler do
  @moduledoc false
  # The connection of a page that is a sensor. Texts are JSON: `ping` and `clock` from the page, `pong` and `credit` to
  # it. Binaries begin with their kind: 1 a picture, 2 sound, both with the page's time; 3 sound to be played.
  @behaviour Situ.Live.SocketHandler

  alias Situ.{AudioBuffer, AudioFormat, EncodedImage, JSON}
  alias Situ.Studio.Sensor

  @registry Situ.Studio.Registry
  # Limits for a page's values: its times lie within a day of ours, and its sound has an audible rate.
  @day_ms 86_400_000
  @rates 8_000..192_000

  @impl true
  def init(%{role: :viewer}, _studio), do: {:error, "who may only look is no sensor"}

  def init(request, _studio) do
    name = request.query["name"] || "page"

    with {:ok, sensor} <- Sensor.find(name),
         {:ok, _} <- Registry.register(@registry, {:sensor_page, name}, nil) do
      Process.monitor(sensor)
      send(sensor, {:sensor_page, self()})
      {:ok, %{sensor: sensor, offset: nil}}
    else
      :error -> {:error, "no pipeline has a sensor of this name"}
      {:error, {:already_registered, _}} -> {:error, "another page is this sensor"}
    end
  end

  @impl true
  def handle_in({text, opcode: :text}, state) do
    case JSON.decode(text) do
      {:ok, %{"ping" => sent}} when is_number(sent) ->
        {:push, text(%{pong: sent, now: System.os_time(:microsecond) / 1_000}), state}

      {:ok, %{"offset" => ms}} when is_number(ms) and abs(ms) < @day_ms ->
        send(state.sensor, {:sensor, :clock, Situ.Time.now(), ms / 1})
        {:ok, %{state | offset: ms}}

      _ ->
        {:stop, {:shutdown, :bad_request}, state}
    end
  end

  # Before the clocks are compared no time means anything.
  def handle_in({_bytes, opcode: :binary}, %{offset: nil} = state), do: {:ok, state}

  def handle_in({bytes, opcode: :binary}, state) do
    with {output, ms, data} <- parse(bytes),
         time = round((ms - state.offset) * 1_000_000),
         true <- abs(time - Situ.Time.now()) < @day_ms * 1_000_000 do
      send(state.sensor, {:sensor, output, time, data})
      {:ok, state}
    else
      _ -> {:stop, {:shutdown, :bad_request}, state}
    end
  end

  defp parse(<<1, _::24, w::little-16, h::little-16, ms::little-float-64, jpeg::binary>>)
       when w > 0 and h > 0 do
    with {:ok, :jpeg} <- EncodedImage.sniff(jpeg),
         do: {:video, ms, %EncodedImage{format: :jpeg, width: w, height: h, data: jpeg}}
  end

  defp parse(<<2, _::24, rate::little-32, ms::little-float-64, pcm::binary>>)
       when rate in @rates and rem(byte_size(pcm), 2) == 0 and pcm != "" do
    with {:ok, buffer} <- AudioBuffer.new(format: AudioFormat.pcm(rate), data: pcm),
         do: {:audio, ms, buffer}
  end

  defp parse(_), do: :error

  @impl true
  def handle_info({:credit, n}, state), do: {:push, text(%{credit: n}), state}

  def handle_info({:play, rate, pcm}, state),
    do: {:push, {:binary, [<<3, 0::24, rate::little-32>>, pcm]}, state}

  def handle_info({:DOWN, _, :process, _, _}, state),
    do: {:stop, {:shutdown, :sensor_ended}, state}

  def handle_info(:sensor_ended, state), do: {:stop, {:shutdown, :sensor_ended}, state}
  def handle_info(_other, state), do: {:ok, state}

  defp text(map), do: {:text, JSON.encode(map)}
end
