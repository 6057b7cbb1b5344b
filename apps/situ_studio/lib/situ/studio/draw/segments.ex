defmodule Situ.Studio.Draw.Segments do
  @moduledoc """
  Lanes of states and labels: what a message says holds until the next. Neighbours that say the same are one segment.

      iex> messages = for {t, v} <- [{0, true}, {1, true}, {2, false}], do: %Situ.Message{data: v, originating_time: t}
      iex> Situ.Studio.Draw.Segments.of(messages, [], nil, :all)
      [{0, 2, "true", "true"}, {2, nil, "false", "false"}]
  """
  alias Situ.Studio.Path

  @type t :: {Situ.Time.t(), Situ.Time.t() | nil, label :: String.t(), class :: String.t()}
  @max_label 200

  @doc "Segments of messages in order; the last one ends at `later`, or is open (`nil`)."
  @spec of([Situ.Message.t()], Path.t(), Situ.Time.t() | nil, :all | :more) :: [t()]
  def of(messages, path, later, _more) do
    messages
    |> Enum.flat_map(&row(&1, path))
    |> close(later)
    |> merge()
  end

  defp row(message, path) do
    case Path.fetch(message.data, path) do
      {:ok, value} -> [{message.originating_time, label(value), class(value)}]
      :error -> []
    end
  end

  defp close([], _), do: []
  defp close([{t, label, class}], later), do: [{t, later, label, class}]

  defp close([{t, label, class} | [{next, _, _} | _] = rest], later),
    do: [{t, next, label, class} | close(rest, later)]

  # Texts stay apart: saying the same twice is two utterances.
  defp merge([{a, _, label, class}, {_, b, label, class} | rest]) when class != "text",
    do: merge([{a, b, label, class} | rest])

  defp merge([{_, _, "", _} | rest]), do: merge(rest)
  defp merge([row | rest]), do: [row | merge(rest)]
  defp merge([]), do: []

  defp label(value) when is_binary(value) do
    if String.valid?(value), do: String.slice(value, 0, @max_label), else: inspect(value)
  end

  defp label(nil), do: ""
  defp label(value) when is_atom(value), do: Atom.to_string(value)

  defp label(value),
    do: value |> inspect(limit: 10, printable_limit: 80) |> String.slice(0, @max_label)

  defp class(true), do: "true"
  defp class(false), do: "false"
  defp class(value) when is_binary(value), do: "text"
  defp class(_), do: "state"
end
