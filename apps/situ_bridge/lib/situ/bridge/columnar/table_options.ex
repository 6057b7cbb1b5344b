defmodule Situ.Bridge.Columnar.TableOptions do
  @moduledoc false
  # The options that Parquet and Arrow share: their schemas, and their validation.
  alias Situ.Bridge.Columnar.Join
  alias Situ.Options

  @read_keys [:from, :to, :skip_damage, :progress]

  @doc "Returns the options of an export. `group` is the format's name for a group of rows."
  @spec export_options(group :: String.t()) :: Options.schema()
  def export_options(group) do
    [
      streams: [
        type: {:optional, {:list, :string}},
        default: nil,
        doc: "The names of the streams to export; by default, all of them."
      ],
      rows: [
        type: :pos_integer,
        default: 100_000,
        doc: "The maximum number of rows in a #{group}."
      ]
    ]
  end

  @doc "Returns the options of a source that reads a table."
  @spec read_options() :: Options.schema()
  def read_options do
    [
      time: [
        type: {:optional, :string},
        default: nil,
        doc:
          "The column with the originating times, read as nanoseconds unless its type has a unit; by default " <>
            "`originating_time`, or else the first column of timestamps."
      ],
      columns: [
        type: {:optional, {:list, :string}},
        default: nil,
        doc: "The names of the columns to read; by default, all of them."
      ],
      from: [
        type: {:optional, :integer},
        default: nil,
        doc: "The first time to read, in nanoseconds; by default, the first time of the table."
      ],
      to: [
        type: {:optional, :integer},
        default: nil,
        doc: "The last time to read, in nanoseconds; by default, the last time of the table."
      ],
      type: [type: :any, default: :any, doc: "The type of the stream."],
      name: [type: :string, doc: "The component's name."]
    ]
  end

  @doc "Validates the options of writing one stream against the schema of an export."
  @spec validate_write!(keyword(), Options.schema()) :: keyword()
  def validate_write!(opts, export), do: validate!(opts, Keyword.delete(export, :streams))

  @doc "Validates the options of writing a joined table against the schema of an export."
  @spec validate_join!(keyword(), Options.schema()) :: keyword()
  def validate_join!(opts, export),
    do: validate!(opts, Keyword.merge(export, Join.join_options()))

  # The store validates the options of reading.
  defp validate!(opts, schema) do
    {read_opts, opts} = Keyword.split(opts, @read_keys)
    Options.validate!(opts, schema) ++ read_opts
  end
end
