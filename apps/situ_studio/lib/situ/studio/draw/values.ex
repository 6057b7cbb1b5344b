defmodule Situ.Studio.Draw.Values do
  @moduledoc """
  The exact values of a stream at a time, which a page shows at the cursor.

  A value is that of the message at or before the time, never one of a summary: it is the same at every zoom. Values
  go to the page as text. A number is written with the fewest digits that read back as the same number, and integers
  that a browser cannot hold keep all of their digits.

      iex> alias Situ.Studio.Draw.Values
      iex> Enum.map([0.1, 123456789.123, 9_007_199_254_740_993, true, :nan, nil], &Values.text/1)
      ["0.1", "123456789.123", "9007199254740993", "true", "nan", nil]
  """
  alias Situ.Studio.{Frame, Hole, Path, Source, Visualizer}

  # So many values of one message are told.
  @most 256

  @typedoc "A part of a message and its value; `\"\"` is the message itself."
  @type named :: {name :: String.t(), value :: term()}

  @doc "The values of the latest message at or before `time`; `name/1` splits what is at the path into named values."
  @spec at(
          Source.t(),
          Frame.channel(),
          Visualizer.spec(),
          Situ.Time.t(),
          (term(), Situ.Message.t() -> [named()])
        ) :: Visualizer.value()
  def at(source, channel, %{stream: stream, path: path}, time, split) do
    case Source.call(source, :latest_at, [stream, time]) do
      {:ok, %{data: %Hole{}}} -> :none
      {:ok, message} -> told(channel, message, Path.fetch(message.data, path), split)
      other -> other
    end
  end

  # At a message without this part the line has a gap.
  defp told(_channel, _message, :error, _split), do: :none

  defp told(channel, message, {:ok, data}, split) do
    mark = {message.originating_time, message.sequence_id}
    {:ok, mark, frame(channel, message.originating_time, split.(data, message))}
  end

  @doc "The frame of named values of the time `time`."
  @spec frame(Frame.channel(), Situ.Time.t(), [named()]) :: Frame.t()
  def frame(channel, time, values) do
    told = for {name, value} <- Enum.take(values, @most), text = text(value), do: [name, text]
    Frame.json(channel, time, %{"time" => Integer.to_string(time), "values" => told})
  end

  @doc "A value as text, exactly; `nil` for none."
  @spec text(term()) :: String.t() | nil
  def text(nil), do: nil
  def text(%Hole{}), do: nil
  def text(value) when is_integer(value), do: Integer.to_string(value)
  def text(value) when is_float(value), do: :erlang.float_to_binary(value, [:short])
  def text(value) when is_atom(value), do: Atom.to_string(value)
  def text(_not_drawn), do: nil
end
