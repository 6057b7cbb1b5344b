defmodule Situ.Bridge.Foxglove.Wire do
  @moduledoc false
  # The messages of Foxglove's WebSocket protocol, for both subprotocols (https://github.com/foxglove/ws-protocol):
  # JSON texts with an `op`, and binary messages with an opcode and little-endian numbers. Pure.

  @max_time 0xFFFFFFFFFFFFFFFF

  @type frame :: {:text | :binary, iodata()}
  @type request ::
          {:op, String.t(), map()}
          | {:playback, :play | :pause, speed :: float(), seek :: integer() | nil, id :: binary()}
          | {:error, String.t()}

  @doc "Parses a frame from a client."
  @spec parse_frame({:text | :binary, binary()}) :: request()
  def parse_frame({:text, text}) do
    case Situ.JSON.decode(text) do
      {:ok, %{"op" => op} = message} when is_binary(op) -> {:op, op, message}
      {:ok, _} -> {:error, "the message has no `op`"}
      {:error, _} -> {:error, "the message is not JSON"}
    end
  end

  def parse_frame(
        {:binary,
         <<3, command, speed::binary-4, seek?, time::little-64, n::little-32, id::binary-size(n)>>}
      )
      when command in [0, 1] and n <= 1_000 do
    case speed do
      <<speed::little-float-32>> when speed >= 0 ->
        {:playback, if(command == 0, do: :play, else: :pause), speed, if(seek? == 1, do: time),
         id}

      _ ->
        {:error, "the speed of the playback request is not a number of at least 0"}
    end
  end

  def parse_frame({:binary, <<op, _::binary>>}),
    do: {:error, "binary messages with opcode #{op} are not supported"}

  def parse_frame({:binary, ""}), do: {:error, "the message is empty"}

  @doc """
  Encodes a JSON message.

      iex> Situ.Bridge.Foxglove.Wire.encode_op("unadvertise", channelIds: [1])
      {:text, ~s({"op":"unadvertise","channelIds":[1]})}
  """
  @spec encode_op(String.t(), Enumerable.t()) :: frame()
  def encode_op(name, members),
    do: {:text, members |> Map.new() |> Map.put(:op, name) |> Situ.JSON.encode()}

  @doc "Encodes a warning (level 1) or an error (level 2) that the client shows to its user."
  @spec encode_status(1 | 2, String.t()) :: frame()
  def encode_status(level, text), do: encode_op("status", level: level, message: text)

  @spec encode_message(non_neg_integer(), Situ.Time.t(), iodata()) :: frame()
  def encode_message(subscription, time, payload),
    do: {:binary, [<<1, subscription::little-32, clamp_time(time)::little-64>>, payload]}

  @spec encode_time(Situ.Time.t()) :: frame()
  def encode_time(time), do: {:binary, <<2, clamp_time(time)::little-64>>}

  @spec encode_playback(:playing | :paused | :ended, Situ.Time.t(), float(), boolean(), binary()) ::
          frame()
  def encode_playback(status, time, speed, seek?, id) do
    number = %{playing: 0, paused: 1, ended: 3}[status]
    seek = if seek?, do: 1, else: 0

    {:binary,
     <<5, number, clamp_time(time)::little-64, speed::little-float-32, seek,
       byte_size(id)::little-32, id::binary>>}
  end

  # The protocol cannot represent times before 1970.
  defp clamp_time(time), do: time |> max(0) |> min(@max_time)
end
