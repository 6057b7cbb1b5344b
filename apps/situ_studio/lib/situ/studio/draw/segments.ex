defmodule Situ.Studio.Draw.Segments do
  @moduledoc """
  Lanes of states and labels: what a message says holds until the next. Neighbours that say the same are one segment. A map
  has a lane for each of its keys, which ends where a message no longer has the key.

      iex> messages = for {t, v} <- [{0, true}, {1, true}, {2, false}], do: %Situ.Message{data: v, originating_time: t}
      iex> Situ.Studio.Draw.Segments.of(messages, [], nil)
      [{0, 2, "true", "true", ""}, {2, nil, "false", "false", ""}]
      iex> messages = for {t, v} <- [{0, %{a: true}}, {1, %{a: true, b: :off}}, {2, %{}}], do: %Situ.Message{data: v, originating_time: t}
      iex> Situ.Studio.Draw.Segments.of(messages, [], nil)
      [{0, 2, "true", "true", "a"}, {1, 2, "off", "state", "b"}]
  """
  alias Situ.Studio.Draw.Key
  alias Situ.Studio.Path

  @typedoc "From, to (`nil`: open), what it says, the way it is drawn, the name of its lane (`\"\"`: the only one)."
  @type t ::
          {Situ.Time.t(), Situ.Time.t() | nil, label :: String.t(), class :: String.t(),
           lane :: String.t()}
  @max_label 200

  @doc "Segments of messages in order, lane by lane; the last ones end at `later`, or are open (`nil`)."
  @spec of([Situ.Message.t()], Path.t(), Situ.Time.t() | nil) :: [t()]
  def of(messages, path, later) do
    by_lane = messages |> spread(path, later) |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))
    keys = for {:key, key} <- Map.keys(by_lane), do: key

    keyed = for key <- Key.sort(keys), do: merge(by_lane[{:key, key}], Key.text(key))
    merge(by_lane[:only] || [], "") ++ Enum.concat(keyed)
  end

  @doc "The lanes of one message's data: the names of a map's keys, or none."
  @spec lanes(term()) :: [String.t()]
  def lanes(data) do
    for {{:key, key}, _} <- entries(data), do: Key.text(key)
  end

  # {lane, {from, to, label, class}} of every message
  defp spread([], _, _), do: []

  defp spread([message | rest], path, later) do
    until =
      case rest do
        [next | _] -> next.originating_time
        [] -> later
      end

    rows =
      case Path.fetch(message.data, path) do
        {:ok, value} ->
          for {lane, v} <- entries(value),
              do: {lane, {message.originating_time, until, label(v), class(v)}}

        :error ->
          []
      end

    rows ++ spread(rest, path, later)
  end

  defp entries(map) when is_map(map) and not is_struct(map),
    do: for({key, value} <- map, do: {{:key, key}, value})

  defp entries(value), do: [{:only, value}]

  # Texts stay apart: saying the same twice is two utterances.
  defp merge([{a, same, label, class}, {same, b, label, class} | rest], lane)
       when class != "text",
       do: merge([{a, b, label, class} | rest], lane)

  defp merge([{_, _, "", _} | rest], lane), do: merge(rest, lane)

  defp merge([{a, b, label, class} | rest], lane),
    do: [{a, b, label, class, lane} | merge(rest, lane)]

  defp merge([], _), do: []

  @doc """
  Many segments shorter than `least` become few: neighbours that are all too short to be told apart are one, of the class `"many"`.

      iex> rows = for t <- 0..9, do: {t, t + 1, "x", "state", ""}
      iex> Situ.Studio.Draw.Segments.thin(rows ++ [{10, 90, "y", "state", ""}], 5, 3)
      [{0, 10, "", "many", ""}, {10, 90, "y", "state", ""}]
  """
  @spec thin([t()], pos_integer(), pos_integer()) :: [t()]
  def thin(rows, least, keep) do
    if length(rows) <= keep,
      do: rows,
      else: rows |> Enum.reduce([], &thin_one(&1, &2, least)) |> Enum.reverse()
  end

  defp thin_one({a, b, _, _, lane} = row, [{from, a, _, class, lane} = last | rest], least)
       when b - a < least do
    if class == "many" or a - from < least,
      do: [{from, b, "", "many", lane} | rest],
      else: [row, last | rest]
  end

  defp thin_one(row, rows, _), do: [row | rows]

  @doc "A value in a few words."
  @spec label(term()) :: String.t()
  def label(value) when is_binary(value) do
    if String.valid?(value), do: String.slice(value, 0, @max_label), else: inspect(value)
  end

  def label(nil), do: ""
  def label(value) when is_atom(value), do: Atom.to_string(value)

  def label(value),
    do: value |> inspect(limit: 10, printable_limit: 80) |> String.slice(0, @max_label)

  defp class(true), do: "true"
  defp class(false), do: "false"
  defp class(value) when is_binary(value), do: "text"
  defp class(_), do: "state"
end
