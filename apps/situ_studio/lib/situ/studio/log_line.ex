defmodule Situ.Studio.LogLine do
  @moduledoc false
  # Reads messages as lines of a log: a level, the name of who wrote it, and a text. Knows texts, and maps like the Log
  # messages of ROS 1, ROS 2 and Foxglove. Pure.
  alias Situ.Studio.Draw.Segments

  @levels ["debug", "info", "warning", "error", "fatal"]

  # ROS 1 has the levels 1, 2, 4, 8 and 16, ROS 2 has 10 to 50; both have the text in `msg`. Foxglove has 1 to 5 and
  # `message`.
  @ros %{1 => 1, 2 => 2, 4 => 3, 8 => 4, 16 => 5, 10 => 1, 20 => 2, 30 => 3, 40 => 4, 50 => 5}
  @words %{
    "trace" => 1,
    "debug" => 1,
    "info" => 2,
    "notice" => 2,
    "warn" => 3,
    "warning" => 3,
    "err" => 4,
    "error" => 4,
    "critical" => 5,
    "fatal" => 5,
    "alert" => 5,
    "emergency" => 5,
    "panic" => 5
  }
  # A level is the first such word near the start of a line, in brackets, in capitals or before a colon.
  @start 80
  @most_text 2_000
  @word ~r/\[\s*(?<a>[a-zA-Z]+)\s*\]|\b(?<b>[A-Z]{3,9})\b|\b(?<c>[a-z]+):/

  @typedoc "`level` is the index of its name, from 1 (debug) to 5 (fatal), or 0 if it is unknown."
  @type t :: %{level: 0..5, name: String.t(), text: String.t()}

  @doc "Returns the names of the levels, from 1."
  @spec level_names() :: [String.t()]
  def level_names, do: @levels

  @doc """
  Reads a message.

      iex> alias Situ.Studio.LogLine
      iex> LogLine.read(%{"level" => 8, "name" => "/planner", "msg" => "no path", "file" => "a.cpp"})
      %{level: 4, name: "/planner", text: "no path"}
      iex> LogLine.read(%{level: 3, message: "hot", name: "cpu"}).level
      3
      iex> for text <- ["12:00:01 [warn] low", "ERROR: gone", "info: hello", "an error is near"],
      ...>   do: LogLine.read(text).level
      [3, 4, 2, 0]
  """
  @spec read(term()) :: t()
  def read(text) when is_binary(text) do
    if String.valid?(text),
      do: %{level: text_level(text), name: "", text: cut_text(text)},
      else: %{level: 0, name: "", text: Segments.value_label(text)}
  end

  def read(%{} = map) when not is_struct(map) do
    {ros, foxglove} = {field(map, :msg), field(map, :message)}
    level = field(map, :level) || field(map, :severity)

    cond do
      is_binary(ros) ->
        %{level: number_level(level, @ros), name: name_of(map), text: cut_text(ros)}

      is_binary(foxglove) ->
        %{level: number_level(level, %{}), name: name_of(map), text: cut_text(foxglove)}

      true ->
        %{level: 0, name: "", text: Segments.value_label(map)}
    end
  end

  def read(value), do: %{level: 0, name: "", text: Segments.value_label(value)}

  defp cut_text(text), do: String.slice(text, 0, @most_text)

  defp field(map, key), do: Map.get(map, key) || Map.get(map, Atom.to_string(key))

  defp name_of(map) do
    case field(map, :name) do
      name when is_binary(name) -> name
      name when is_atom(name) and name != nil -> Atom.to_string(name)
      _ -> ""
    end
  end

  defp number_level(level, known) when is_integer(level),
    do: known[level] || if(level in 1..5, do: level, else: 0)

  defp number_level(level, _) when is_atom(level) and level != nil,
    do: Map.get(@words, Atom.to_string(level), 0)

  defp number_level(level, _) when is_binary(level),
    do: Map.get(@words, String.downcase(level), 0)

  defp number_level(_, _), do: 0

  defp text_level(text) do
    @word
    |> Regex.scan(String.slice(text, 0, @start), capture: :all_names)
    |> Enum.find_value(0, fn words -> Enum.find_value(words, &@words[String.downcase(&1)]) end)
  end
end
