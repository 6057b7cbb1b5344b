defmodule Situ.Bridge.Format.Json do
  @moduledoc false
  # Encodes messages as JSON; a file is an array of them.
  @behaviour Situ.Bridge.Format
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Bridge.Format.{TimeFormat, Value}

  # Real messages are not larger than this; without a limit, an unclosed bracket would fill the memory.
  @max_message 64 * 1024 * 1024

  @impl true
  def encode(value, time) do
    ordered =
      {[{"originatingTime", TimeFormat.to_iso8601(time)}, {"message", Value.to_plain(value)}]}

    Situ.JSON.encode(ordered)
  end

  @impl true
  def decode(bytes, opts) do
    with {:ok, {pairs}} <- Situ.JSON.decode(bytes, objects: :pairs),
         {:ok, stamp} when is_binary(stamp) <- Value.fetch_member(pairs, "originatingTime"),
         {:ok, value} <- Value.fetch_member(pairs, "message"),
         {:ok, time} <- Situ.Time.parse(stamp) do
      {:ok, {time, Value.shape_objects(value, opts)}}
    else
      {:error, :bad_json} -> {:error, "it is not JSON"}
      {:error, %Situ.Error{what: what}} -> {:error, "its originatingTime is #{what}"}
      {:ok, _} -> {:error, "it is not an object with originatingTime and message"}
      :error -> {:error, "it has no originatingTime or no message"}
    end
  end

  @impl true
  def record(value, time, 0), do: ["[", encode(value, time)]
  def record(value, time, _n), do: [",", encode(value, time)]

  @impl true
  def finish(0), do: "[]"
  def finish(_n), do: "]"

  @impl true
  def start, do: :before

  # The states: `:before` the array's bracket, `:first` (a value or the end), `:within` (a value), `:next` (a comma or
  # the end), and the state after the array.
  @impl true
  def split(bytes, state, last?, opts), do: split_messages(bytes, state, last?, opts, [])

  defp split_messages(<<c, rest::binary>>, state, last?, opts, messages) when c in ~c" \t\r\n",
    do: split_messages(rest, state, last?, opts, messages)

  defp split_messages(<<0xEF, 0xBB, 0xBF, rest::binary>>, :before, last?, opts, messages),
    do: split_messages(rest, :before, last?, opts, messages)

  defp split_messages("[" <> rest, :before, last?, opts, messages),
    do: split_messages(rest, :first, last?, opts, messages)

  defp split_messages("]" <> rest, state, last?, opts, messages) when state in [:first, :next],
    do: split_messages(rest, :behind, last?, opts, messages)

  defp split_messages("," <> rest, :next, last?, opts, messages),
    do: split_messages(rest, :within, last?, opts, messages)

  defp split_messages("{" <> _ = bytes, state, last?, opts, messages)
       when state in [:first, :within] do
    case object_size(bytes) do
      {:ok, size} ->
        <<text::binary-pinned_size(size), rest::binary>> = bytes

        with {:ok, message} <- decode(text, opts),
             do: split_messages(rest, :next, last?, opts, [message | messages])

      :more when byte_size(bytes) > @max_message ->
        {:error, "a message is longer than #{@max_message} bytes"}

      :more when last? ->
        end_of_file(messages)

      :more ->
        {:ok, Enum.reverse(messages), {bytes, state}}
    end
  end

  defp split_messages("", :behind, _last?, _opts, messages),
    do: {:ok, Enum.reverse(messages), {"", :behind}}

  defp split_messages("", _state, true, _opts, messages), do: end_of_file(messages)

  defp split_messages("", state, false, _opts, messages),
    do: {:ok, Enum.reverse(messages), {"", state}}

  defp split_messages(<<c, _::binary>>, _state, _last?, _opts, []),
    do: {:error, "it has #{inspect(<<c>>)} where a message, a comma or the end is expected"}

  defp split_messages(bytes, state, _last?, _opts, messages),
    do: {:ok, Enum.reverse(messages), {bytes, state}}

  # A truncated file, whose writer was killed, ends after its last complete message.
  defp end_of_file(messages), do: {:ok, Enum.reverse(messages), {"", :behind}}

  # Returns the length of the object at the beginning of `bytes`.
  defp object_size(bytes), do: object_size(bytes, 0, 0)

  defp object_size(bytes, at, depth) do
    case bytes do
      <<_::binary-pinned_size(at), c, _::binary>> when c in ~c"{[" ->
        object_size(bytes, at + 1, depth + 1)

      <<_::binary-pinned_size(at), c, _::binary>> when c in ~c"}]" and depth == 1 ->
        {:ok, at + 1}

      <<_::binary-pinned_size(at), c, _::binary>> when c in ~c"}]" ->
        object_size(bytes, at + 1, depth - 1)

      <<_::binary-pinned_size(at), ?", _::binary>> ->
        skip_string(bytes, at + 1, depth)

      <<_::binary-pinned_size(at), _, _::binary>> ->
        object_size(bytes, at + 1, depth)

      _ ->
        :more
    end
  end

  defp skip_string(bytes, at, depth) do
    case bytes do
      <<_::binary-pinned_size(at), ?\\, _, _::binary>> -> skip_string(bytes, at + 2, depth)
      <<_::binary-pinned_size(at), ?", _::binary>> -> object_size(bytes, at + 1, depth)
      <<_::binary-pinned_size(at), _, _::binary>> -> skip_string(bytes, at + 1, depth)
      _ -> :more
    end
  end
end
