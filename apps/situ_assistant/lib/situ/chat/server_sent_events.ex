defmodule Situ.Chat.ServerSentEvents do
  @moduledoc false
  # Parses server-sent events (WHATWG HTML, 9.2) from arbitrarily split bytes, and returns the
  # `data` of each event.
  #
  # Lines end with LF, CRLF or CR. A leading byte order mark is skipped. An event of more than 1
  # MiB is an error.
  @most 1_048_576

  # A CR at the end of the bytes may be half of a CRLF, so it ends the line, and an LF directly after it is skipped.
  defstruct line: "", data: [], size: 0, cr?: false, begun?: false

  @type t :: %__MODULE__{
          line: binary(),
          data: [binary()],
          size: non_neg_integer(),
          cr?: boolean(),
          begun?: boolean()
        }

  @doc "Returns an empty parser state."
  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc """
  Adds `bytes` and returns the data of the events that are now complete, in order.

      iex> {:ok, [], events} = Situ.Chat.ServerSentEvents.push(Situ.Chat.ServerSentEvents.new(), "data: one\\n")
      iex> {:ok, data, _} = Situ.Chat.ServerSentEvents.push(events, "\\n: a comment\\n\\ndata: two\\r\\n\\r\\n")
      iex> data
      ["one", "two"]
  """
  @spec push(t(), binary()) :: {:ok, [binary()], t()} | {:error, :too_long}
  def push(%__MODULE__{cr?: true} = events, "\n" <> bytes),
    do: push(%{events | cr?: false}, bytes)

  def push(%__MODULE__{} = events, ""), do: {:ok, [], events}

  def push(%__MODULE__{} = events, bytes) do
    lines = :binary.split(events.line <> bytes, ["\r\n", "\n", "\r"], [:global])
    [last | whole] = Enum.reverse(lines)
    {found, events} = whole |> Enum.reverse() |> Enum.reduce({[], events}, &parse_line/2)
    events = %{events | line: last, cr?: :binary.last(bytes) == ?\r}

    if byte_size(last) + events.size > @most,
      do: {:error, :too_long},
      else: {:ok, Enum.reverse(found), events}
  end

  defp parse_line("\uFEFF" <> text, {found, %{begun?: false} = events}),
    do: parse_line(text, {found, %{events | begun?: true}})

  defp parse_line(text, {found, events}) do
    events = %{events | begun?: true}

    case text do
      "" when events.data == [] -> {found, events}
      "" -> {[join_data(events) | found], %{events | data: [], size: 0}}
      "data: " <> data -> {found, add_data(events, data)}
      "data:" <> data -> {found, add_data(events, data)}
      "data" -> {found, add_data(events, "")}
      _comment_or_other_field -> {found, events}
    end
  end

  defp join_data(events), do: events.data |> Enum.reverse() |> Enum.join("\n")

  defp add_data(events, data),
    do: %{events | data: [data | events.data], size: events.size + byte_size(data) + 1}
end
