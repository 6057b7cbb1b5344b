defmodule Situ.Bridge.Protobuf.Stamp do
  @moduledoc false
  # The field with the originating time of a message, as a path of names.
  alias Situ.Bridge.Protobuf.Schema
  alias Situ.Error

  @default_paths [["timestamp"], ["time"], ["stamp"], ["originating_time"], ["header", "stamp"]]
  @integers [:int64, :uint64, :fixed64, :sfixed64, :sint64]

  @type t :: [String.t(), ...]

  @doc "Returns the path of the field `name`, or of the first field with a usual name. Raises `Situ.Error`, `:no_time`."
  @spec find_field!(Schema.t(), String.t(), String.t() | nil) :: t()
  def find_field!(schema, type, nil) do
    Enum.find(@default_paths, &time_field?(schema, type, &1)) ||
      raise no_time_error(
              type,
              "none of #{Enum.map_join(@default_paths, ", ", &Enum.join(&1, "."))} exists as a time field"
            )
  end

  def find_field!(schema, type, name) do
    path = String.split(name, ".")

    if time_field?(schema, type, path),
      do: path,
      else:
        raise(no_time_error(type, "#{name} is not a Timestamp or a 64-bit integer in this type"))
  end

  defp no_time_error(type, why) do
    Error.new(:no_time, "#{type} has no field for the originating time",
      why: why,
      fix: "name a field with time:, or read the file with every:"
    )
  end

  defp time_field?(schema, type, [name | rest]) do
    with %{fields: fields} <- schema.messages[type],
         %{repeated?: false, type: inner} <- Enum.find(fields, &(&1.name == name)) do
      case {inner, rest} do
        {{:message, "google.protobuf.Timestamp"}, []} -> true
        {integer, []} -> integer in @integers
        {{:message, inner}, _} -> time_field?(schema, inner, rest)
        _ -> false
      end
    else
      _ -> false
    end
  end

  @doc "Returns the time in a message, or 0 if it is missing, which is Protobuf's default."
  @spec get_time(map(), t()) :: Situ.Time.t()
  def get_time(message, [name]), do: message[name] || 0
  def get_time(message, [name | rest]), do: get_time(message[name] || %{}, rest)

  @doc "Puts a time into a message."
  @spec put_time(map(), t(), Situ.Time.t()) :: map()
  def put_time(message, [name], time), do: Map.put(message, name, time)

  def put_time(message, [name | rest], time),
    do: Map.put(message, name, put_time(message[name] || %{}, rest, time))
end
