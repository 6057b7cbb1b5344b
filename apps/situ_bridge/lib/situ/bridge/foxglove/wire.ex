defmodule Situ.Bridge.Foxglove.Wire do
  @moduledoc false
  # The messages of Foxglove's WebSocket protocol, of both families (https://github.com/foxglove/ws-protocol): JSON texts
  # with an `op`, and binary messages of an opcode and little-endian numbers. Pure.

  @most_time 0xFFFFFFFFFFFFFFFF

  @type frame :: {:text | :binary, iodata()}
  @type heard ::
          {:op, String.t(), map()}
          | {:playback, :play | :pause, speed :: float(), seek :: integer() | nil, id :: binary()}
          | {:error, String.t()}

  @doc "Parses a frame of a client."
  @spec read({:text | :binary, binary()}) :: heard()
  def read({:text, text}) do
    case Situ.JSON.decode(text) do
      {:ok, %{"op" => op} = message} when is_binary(op) -> {:op, op, message}
      {:ok, _} -> {:error, "a message without op"}
      {:error, _} -> {:error, "a message that is not JSON"}
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
        {:error, "a playback request with a speed that is none"}
    end
  end

  def read({:binary, <<op, _::binary>>}),
    do: {:error, "a message of the kind #{op}, which is not supported here"}

  def read({:binary, ""}), do: {:error, "an empty message"}

  @doc """
      iex> Situ.Bridge.Foxglove.Wire.op("unadvertise", channelIds: [1])
      {:text, ~s({"op":"unadvertise","channelIds":[1]})}
  """
  @spec op(String.t(), Enumerable.t()) :: frame()
  def op(name, members),
    do: {:text, members |> Map.new() |> Map.put(:op, name) |> Situ.JSON.encode()}

  @doc "A warning (1) or an error (2) for people."
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

  # Times before 1970 there are none.
  defp time(time), do: time |> max(0) |> min(@most_time)
end
