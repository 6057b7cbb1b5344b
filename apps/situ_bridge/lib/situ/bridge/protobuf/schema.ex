defmodule Situ.Bridge.Protobuf.Schema do
  @moduledoc false
  # The messages and enumerations of a definition, by their full names. `Protobuf.ProtoParser` and
  # `Protobuf.Descriptor` parse them, and `new/2` checks and completes them. Pure.

  defmodule Field do
    @moduledoc false
    # `type` is `:double` ... `:sint64`, `{:message, name}` or `{:enum, name}`. With `presence?`, a missing field is
    # `nil`.
    @enforce_keys [:name, :number, :type]
    defstruct [
      :name,
      :number,
      :type,
      repeated?: false,
      packed?: false,
      presence?: false,
      oneof: nil
    ]

    @type t :: %__MODULE__{}
  end

  @enforce_keys [:messages, :enums]
  defstruct [:messages, :enums]

  @type message :: %{
          fields: [Field.t()],
          by_number: %{pos_integer() => Field.t()},
          empty: map(),
          map?: boolean(),
          oneofs?: boolean()
        }
  @type enum :: %{names: %{integer() => String.t()}, numbers: %{String.t() => integer()}}
  @type t :: %__MODULE__{messages: %{String.t() => message()}, enums: %{String.t() => enum()}}

  @scalars ~w(double float int64 uint64 int32 fixed64 fixed32 bool string bytes uint32 sfixed32 sfixed64 sint32 sint64)a
  @names Map.new(@scalars, &{Atom.to_string(&1), &1})
  @max_types 5_000
  @max_fields 2_000

  @doc "Returns the scalar type with this name."
  @spec fetch_scalar(String.t()) :: {:ok, atom()} | :error
  def fetch_scalar(name), do: Map.fetch(@names, name)

  @doc """
  Builds a schema of messages (`{name, fields, map?}`) and enumerations (`{name, [{name, number}]}`). Errors are
  sentences about unknown types, invalid field numbers, or too many types or fields.
  """
  @spec new([{String.t(), [Field.t()], boolean()}], [{String.t(), [{String.t(), integer()}]}]) ::
          {:ok, t()} | {:error, String.t()}
  def new(messages, enums) do
    enums = Map.new(enums, fn {name, values} -> {name, build_enum(values)} end)
    names = MapSet.new(messages, &elem(&1, 0))

    with :ok <- check_limits(messages, enums),
         :ok <- check_fields(messages, names, enums) do
      schema = %__MODULE__{messages: %{}, enums: enums}
      maps = for {name, _, true} <- messages, into: MapSet.new(), do: name
      {:ok, %{schema | messages: Map.new(messages, &build_message(&1, enums, maps))}}
    end
  end

  defp build_enum(values) do
    # If several names share a number, the first name is used.
    %{
      names: values |> Enum.reverse() |> Map.new(fn {name, number} -> {number, name} end),
      numbers: Map.new(values)
    }
  end

  defp check_limits(messages, enums) do
    cond do
      length(messages) + map_size(enums) > @max_types ->
        {:error, "it has more than #{@max_types} types"}

      message = Enum.find(messages, fn {_, fields, _} -> length(fields) > @max_fields end) ->
        {:error, "#{elem(message, 0)} has more than #{@max_fields} fields"}

      true ->
        :ok
    end
  end

  defp check_fields(messages, names, enums) do
    Enum.find_value(messages, :ok, fn {name, fields, _} ->
      Enum.find_value(fields, fn field ->
        with why when is_binary(why) <- find_problem(field, names, enums),
             do: {:error, "the field #{inspect(field.name)} of #{name} #{why}"}
      end)
    end)
  end

  defp find_problem(%{number: n}, _names, _enums) when n not in 1..536_870_911,
    do: "has the number #{inspect(n)}"

  defp find_problem(%{type: {:message, type}}, names, _enums),
    do: if(type not in names, do: "has the unknown type #{type}")

  defp find_problem(%{type: {:enum, type}}, _names, enums),
    do: if(not is_map_key(enums, type), do: "has the unknown type #{type}")

  defp find_problem(_field, _names, _enums), do: nil

  defp build_message({name, fields, map?}, enums, maps) do
    fields = Enum.map(fields, &clear_presence/1)

    {name,
     %{
       fields: fields,
       by_number: Map.new(fields, &{&1.number, &1}),
       empty: Map.new(fields, &{&1.name, default_value(&1, enums, maps)}),
       map?: map?,
       oneofs?: Enum.any?(fields, &(&1.oneof != nil))
     }}
  end

  # A missing message is `nil` in any case.
  defp clear_presence(%{type: {:message, _}} = field), do: %{field | presence?: false}
  defp clear_presence(field), do: field

  defp default_value(%{repeated?: true, type: {:message, type}}, _enums, maps),
    do: if(type in maps, do: %{}, else: [])

  defp default_value(%{repeated?: true}, _enums, _maps), do: []
  defp default_value(%{type: {:message, _}}, _enums, _maps), do: nil
  defp default_value(%{presence?: true}, _enums, _maps), do: nil
  defp default_value(%{type: {:enum, name}}, enums, _maps), do: Map.get(enums[name].names, 0, 0)
  defp default_value(%{type: type}, _enums, _maps), do: zero_value(type)

  @doc "Returns the wire type of a type: 0, 1, 2 or 5."
  @spec wire_type(atom() | {:message | :enum, String.t()}) :: 0 | 1 | 2 | 5
  def wire_type({:message, _}), do: 2
  def wire_type({:enum, _}), do: 0
  def wire_type(type) when type in [:string, :bytes], do: 2
  def wire_type(type) when type in [:double, :fixed64, :sfixed64], do: 1
  def wire_type(type) when type in [:float, :fixed32, :sfixed32], do: 5
  def wire_type(_varint), do: 0

  @doc "Returns the kind (`Situ.Bridge.Ros.Number`) and size in bytes of a fixed-size number, or `nil` for other types."
  @spec fixed_kind(atom() | tuple()) :: {atom(), 4 | 8} | nil
  def fixed_kind(:double), do: {:float64, 8}
  def fixed_kind(:fixed64), do: {:uint64, 8}
  def fixed_kind(:sfixed64), do: {:int64, 8}
  def fixed_kind(:float), do: {:float32, 4}
  def fixed_kind(:fixed32), do: {:uint32, 4}
  def fixed_kind(:sfixed32), do: {:int32, 4}
  def fixed_kind(_type), do: nil

  @doc "Returns the default value of a scalar type, which is used for fields that are not encoded."
  @spec zero_value(atom()) :: term()
  def zero_value(type) when type in [:double, :float], do: 0.0
  def zero_value(:bool), do: false
  def zero_value(type) when type in [:string, :bytes], do: ""
  def zero_value(_integer), do: 0
end
