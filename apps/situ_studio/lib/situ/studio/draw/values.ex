defmodule Situ.Studio.Draw.Values do
  @moduledoc false
  # Reads the exact values of a stream at a time, which a page shows at the cursor.
  #
  # A value comes from the latest message at or before the time and never from a summary, so it is
  # the same at every zoom. Values go to the page as text. A float has the fewest digits that read
  # back as the same number, and an integer that a browser cannot hold exactly keeps all of its
  # digits.
  # The page once took the value at the cursor from the bin under it, and one cursor showed
  # 10.745, 9.0532 or 8.2688, depending on the zoom. The server therefore sends the value for each
  # cursor, on the path that images use. If the page searched raw messages itself, it would need
  # the rules of sources (gaps, late messages, audio) a second time.
  alias Situ.Studio.{Frame, Gap, ValuePath, Visualizer, StreamReader}

  # The page gets at most this many values of one message.
  @max_values 256

  @typedoc "A part of a message and its value; `\"\"` is the message itself."
  @type named :: {name :: String.t(), value :: term()}

  @doc """
  Returns the values of the latest message at or before `time`. `split` gets the data at the path and the message, and
  returns the named values.
  """
  @spec fetch_at(
          Situ.Recording.t(),
          Frame.channel(),
          Visualizer.spec(),
          Situ.Time.t(),
          (term(), Situ.Message.t() -> [named()])
        ) :: Visualizer.value()
  def fetch_at(source, channel, %{stream: stream, path: path}, time, split) do
    case StreamReader.latest_at(source, stream, time) do
      {:ok, %{data: %Gap{}}} ->
        :none

      {:ok, message} ->
        message_value(channel, message, ValuePath.fetch(message.data, path), split)

      other ->
        other
    end
  end

  # The line has a gap at a message without this part.
  defp message_value(_channel, _message, :error, _split), do: :none

  defp message_value(channel, message, {:ok, data}, split) do
    mark = {message.originating_time, message.sequence_id}
    {:ok, mark, values_frame(channel, message.originating_time, split.(data, message))}
  end

  @doc "Builds the frame of the named values at `time`."
  @spec values_frame(Frame.channel(), Situ.Time.t(), [named()]) :: Frame.t()
  def values_frame(channel, time, values) do
    texts =
      for {name, value} <- Enum.take(values, @max_values),
          text = format_exact(value),
          do: [name, text]

    Frame.json(channel, time, %{"time" => Integer.to_string(time), "values" => texts})
  end

  @doc """
  Formats a value exactly. Returns `nil` for terms that are not drawn.

      iex> alias Situ.Studio.Draw.Values
      iex> Enum.map([0.1, 123456789.123, 9_007_199_254_740_993, true, :nan, nil], &Values.format_exact/1)
      ["0.1", "123456789.123", "9007199254740993", "true", "nan", nil]
  """
  @spec format_exact(term()) :: String.t() | nil
  def format_exact(nil), do: nil
  def format_exact(%Gap{}), do: nil
  def format_exact(value) when is_integer(value), do: Integer.to_string(value)
  def format_exact(value) when is_float(value), do: :erlang.float_to_binary(value, [:short])
  def format_exact(value) when is_atom(value), do: Atom.to_string(value)
  def format_exact(_not_drawn), do: nil
end
