defmodule Situ.Bridge.Ros2.TypeHash do
  @moduledoc false
  # Computes the hash with which ROS 2 checks that both sides use the same type (REP 2016, "RIHS01"): the SHA-256 of a
  # description of the type and of all the types that it contains. Pure.
  alias Situ.Bridge.Ros.Definition

  @ids %{
    int8: 2,
    uint8: 3,
    int16: 4,
    uint16: 5,
    int32: 6,
    uint32: 7,
    int64: 8,
    uint64: 9,
    float32: 10,
    float64: 11,
    bool: 15,
    string: 17,
    wstring: 18
  }

  # The types that a service consists of, in addition to the type of the service itself.
  @service_parts ["_Request", "_Response", "_Event"]

  @doc """
  Returns the hash of a ROS 2 definition.

      iex> {:ok, text} = Situ.Bridge.Ros.Definition.parse("std_msgs/String", "string data", :ros2)
      iex> Situ.Bridge.Ros2.TypeHash.hash_definition(text)
      "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
  """
  @spec hash_definition(Definition.t()) :: String.t()
  def hash_definition(%Definition{name: name, types: types}), do: hash_type(name, types, [])

  @doc """
  Returns the hash of a service, which covers its request, its response, and the event message about its calls.

      iex> text = "int64 a\\nint64 b\\n---\\nint64 sum"
      iex> {:ok, service} = Situ.Bridge.Ros.Definition.parse_service("example_interfaces/AddTwoInts", text, :ros2)
      iex> Situ.Bridge.Ros2.TypeHash.hash_service("example_interfaces/AddTwoInts", service)
      "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
  """
  @spec hash_service(String.t(), %{
          :request => Definition.t(),
          :response => Definition.t(),
          optional(atom()) => term()
        }) :: String.t()
  def hash_service(name, %{request: request, response: response}) do
    parts = [
      "#{request.name} request_message\n#{response.name} response_message\n#{name}_Event event_message",
      "MSG: #{name}_Event\nservice_msgs/ServiceEventInfo info\n" <>
        "#{request.name}[<=1] request\n#{response.name}[<=1] response",
      "MSG: #{request.name}\n#{request.text}",
      "MSG: #{response.name}\n#{response.text}"
    ]

    text = Enum.join(parts, "\n" <> String.duplicate("=", 80) <> "\n")
    {:ok, definition} = Definition.parse(name, text, :ros2)
    hash_type(name, definition.types, [name | for(part <- @service_parts, do: name <> part)])
  end

  # `services` contains the types that belong to a service; their full names contain `/srv/`.
  defp hash_type(name, types, services) do
    others = name |> collect_types(types, MapSet.new()) |> MapSet.delete(name)
    referenced = others |> Enum.sort_by(&full_name(&1, services))

    json = [
      ~s({"type_description": ),
      describe_type(name, types, services),
      ~s(, "referenced_type_descriptions": [),
      referenced |> Enum.map(&describe_type(&1, types, services)) |> Enum.intersperse(", "),
      "]}"
    ]

    "RIHS01_" <> Base.encode16(:crypto.hash(:sha256, json), case: :lower)
  end

  defp collect_types(name, types, names) do
    if name in names do
      names
    else
      for {_, type} <- types[name].fields,
          {:message, inner} <- [element_type(type)],
          reduce: MapSet.put(names, name) do
        names -> collect_types(inner, types, names)
      end
    end
  end

  defp element_type({:array, type, _}), do: type
  defp element_type({:list, type}), do: type
  defp element_type(type), do: type

  defp full_name(name, services) do
    kind = if name in services, do: "/srv/", else: "/msg/"
    String.replace(name, "/", kind, global: false)
  end

  defp describe_type(name, types, services) do
    %{fields: fields, texts: texts} = types[name]
    fields = Enum.zip_with(fields, texts, &describe_field(&1, &2, services))

    [
      ~s({"type_name": "#{full_name(name, services)}", "fields": [),
      Enum.intersperse(fields, ", "),
      "]}"
    ]
  end

  defp describe_field({name, type}, type_text, services) do
    {id, nested} = type_id(element_type(type), type_text, services)
    {text, list?, bound} = parse_bounds(type_text)
    {offset, capacity} = array_capacity(type, list?, bound)
    # Bounded strings have separate type ids.
    id = if text > 0, do: id + 4, else: id

    ~s({"name": "#{name}", "type": {"type_id": #{id + offset}, "capacity": #{capacity}, ) <>
      ~s("string_capacity": #{text}, "nested_type_name": "#{nested}"}})
  end

  defp type_id({:message, name}, _spelled, services), do: {1, full_name(name, services)}
  defp type_id(:int8, "byte" <> _, _services), do: {16, ""}
  defp type_id(type, _spelled, _services), do: {Map.fetch!(@ids, type), ""}

  # Parses the maximum lengths of a string and of a list.
  defp parse_bounds(type_text) do
    [_, text, bounded, n] =
      ~r/\A[\w\/]+?(?:<=(\d+))?(?:\[(<=)?(\d*)\])?\z/
      |> Regex.run(type_text)
      |> Kernel.++(["", "", "", ""])
      |> Enum.take(4)

    {parse_number(text), bounded != "", parse_number(n)}
  end

  defp parse_number(""), do: 0
  defp parse_number(digits), do: String.to_integer(digits)

  defp array_capacity({:array, _, n}, _bounded?, _n), do: {48, n}
  defp array_capacity({:list, _}, true, n), do: {96, n}
  defp array_capacity({:list, _}, false, _n), do: {144, 0}
  defp array_capacity(_type, _bounded?, _n), do: {0, 0}
end
