defmodule Situ.Bridge.Ros.Db3.Topics do
  @moduledoc false
  # Reads the tables that describe the topics of a ROS 2 bag in SQLite, in all versions of the format.
  alias Situ.Bridge.Ros.{Definition, Library}
  alias Situ.Bridge.Ros.Db3.Sqlite
  alias Situ.Error

  @type topic :: %{
          id: integer(),
          name: String.t(),
          type: String.t(),
          format: String.t(),
          metadata: [{String.t(), String.t()}]
        }

  # Columns that later versions of the format have added, with the names that MCAP files of ROS 2 use.
  @added_columns [
    {"offered_qos_profiles", "offered_qos_profiles"},
    {"type_description_hash", "topic_type_hash"}
  ]

  @doc "Returns the topics. Rows whose number is none are skipped."
  @spec read_topics(Path.t()) :: {:ok, [topic()]} | {:error, Error.t()}
  def read_topics(path) do
    with {:ok, found} <- Sqlite.query(path, "select name from pragma_table_info('topics')"),
         added = for({column, _} = pair <- @added_columns, [column] in found, do: pair),
         columns = Enum.map_join(added, &", hex(#{elem(&1, 0)})"),
         sql = "select id, name, type, serialization_format#{columns} from topics order by id",
         {:ok, rows} <- Sqlite.query(path, sql),
         do: {:ok, Enum.flat_map(rows, &parse_topic(&1, added))}
  end

  defp parse_topic([id, name, type, format | values], added) do
    for [id] <- parse_numbers([id]) do
      metadata =
        for {{_column, key}, hex} <- Enum.zip(added, values),
            {:ok, value} when value != "" <- [Base.decode16(hex)],
            do: {key, value}

      %{id: id, name: name, type: type, format: format, metadata: metadata}
    end
  end

  defp parse_topic(_row, _added), do: []

  @doc "Parses a row of numbers. SQLite allows text in any column: the list is empty if a value is not a number."
  @spec parse_numbers([String.t()]) :: [[integer()]]
  def parse_numbers(row) do
    parsed = Enum.map(row, &Integer.parse/1)
    if Enum.all?(parsed, &match?({_, ""}, &1)), do: [Enum.map(parsed, &elem(&1, 0))], else: []
  end

  @doc "Returns the definitions in the file, by type: the language and the text. Files from before Iron contain none."
  @spec read_definitions(Path.t()) ::
          {:ok, %{String.t() => {String.t(), String.t()}}} | {:error, Error.t()}
  def read_definitions(path) do
    table_sql =
      "select name from sqlite_master where type = 'table' and name = 'message_definitions'"

    definitions_sql =
      "select topic_type, encoding, hex(encoded_message_definition) from message_definitions"

    with {:ok, [_]} <- Sqlite.query(path, table_sql),
         {:ok, rows} <- Sqlite.query(path, definitions_sql) do
      {:ok,
       for(
         [type, language, hex] <- rows,
         {:ok, text} <- [Base.decode16(hex)],
         into: %{},
         do: {type, {language, text}}
       )}
    else
      {:ok, []} -> {:ok, %{}}
      error -> error
    end
  end

  @doc "Returns the definition of a standard type, or `nil`."
  @spec standard_definition(String.t()) :: String.t() | nil
  def standard_definition(type) do
    case Library.fetch(Definition.strip_kind(type), :ros2) do
      {:ok, text} -> text
      :error -> nil
    end
  end
end
