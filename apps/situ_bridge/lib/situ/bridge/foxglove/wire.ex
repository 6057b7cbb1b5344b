defmodule Situ.Bridge.Foxglove.Wire do
  @moduledoc false
  # The messages of Foxglove's WebSocket protocol, for both subprotocols (https://github.com/foxglove/ws-protocol):
  # JSON texts with an `op`, and binary messages with an opcode and little-endian numbers. Pure.

  @most_time 0xFFFFFFFFFFFFFFFF

  @type frame :: {:text | :binary, iodata()}
  @type heard ::
          {:op, String.t(), map()}
          | {:playback, :play | :pause, speed :: float(), seek :: integer() | nil, id :: binary()}
          | {:error, String.t()}

  @doc "Parses a frame from a client."
  @spec read({:text | :binary, binary()}) :: heard()
  def read({:text, text}) do
    case Situ.JSON.decode(text) do
      {:ok, %{"op" => op} = message} when is_binary(op) -> {:op, op, message}
      {:ok, _} -> {:error, "the message has no `op`"}
      {:error, _} -> {:error, "the message is not JSON"}
    end
  end

  def read(
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

  def read({:binary, <<op, _::binary>>}),
    do: {:error, "binary messages with opcode #{op} are not supported"}

  def read({:binary, ""}), do: {:error, "the message is empty"}

  @doc """
  Encodes a JSON message.

      iex> Situ.Bridge.Foxglove.Wire.op("unadvertise", channelIds: [1])
      {:text, ~s({"op":"unadvertise","channelIds":[1]})}
  """
  @spec op(String.t(), Enumerable.t()) :: frame()
  def op(name, members),
    do: {:text, members |> Map.new() |> Map.put(:op, name) |> Situ.JSON.encode()}

  @doc "Encodes a warning (level 1) or an error (level 2) that the client shows to its user."
  @spec status(1 | 2, String.t()) :: frame()
  def status(level, text), do: op("status", level: level, message: text)

  @spec data(non_neg_integer(), Situ.Time.t(), iodata()) :: frame()
  def data(subscription, time, payload),
    do: {:binary, [<<1, subscription::little-32, time(time)::little-64>>, payload]}

  @spec time_is(Situ.Time.t()) :: frame()
  def time_is(time), do: {:binary, <<2, time(time)::little-64>>}

  @spec playback_is(:playing | :paused | :ended, Situ.Time.t(), float(), boolean(), binary()) ::
          frame()
  def playback_is(status, time, speed, seek?, id) do
    number = %{playing: 0, paused: 1, ended: 3}[status]
    seek = if seek?, do: 1, else: 0

    {:binary,
     <<5, number, time(time)::little-64, speed::little-float-32, seek, byte_size(id)::little-32,
       id::binary>>}
  end

  # The protocol has no times before 1970.
  defp time(time), do: time |> max(0) |> min(@most_time)
end
