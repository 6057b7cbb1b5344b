defmodule Situ.Store.SchemaEvolution do
  @moduledoc false
  # Reads structs that have changed since they were recorded, by the rules in the documentation of
  # `Situ.Store.messages/3`.
  alias Situ.Error
  alias Situ.Store.StreamInfo

  @doc "Returns a function that converts a batch of messages to struct `type`, or the identity function for `nil`."
  @spec build_upgrade!(StreamInfo.t(), module() | nil) ::
          ([Situ.Message.t()] -> [Situ.Message.t()])
  def build_upgrade!(_info, nil), do: & &1

  def build_upgrade!(%StreamInfo{} = info, type) do
    case check_readable(info, type) do
      :ok ->
        checked =
          if loose_type?(info.type) and info.type != type,
            do: &ensure_type!(&1, info, type),
            else: & &1

        if struct_module?(type),
          do: &Enum.map(&1, fn m -> checked.(%{m | data: convert_to_struct(type, m.data)}) end),
          else: if(loose_type?(info.type), do: &Enum.map(&1, checked), else: & &1)

      {:error, error} ->
        raise error
    end
  end

  # A stream with a loose recorded type is checked message by message when a specific type is requested.
  defp loose_type?(type) when type in [:any, :list, :tuple, :map], do: true

  defp loose_type?(type) when is_tuple(type),
    do: type |> Tuple.to_list() |> List.flatten() |> Enum.any?(&loose_type?/1)

  defp loose_type?(_type), do: false

  defp ensure_type!(message, info, type) do
    if Situ.Type.valid_value?(type, message.data) do
      message
    else
      time = Situ.Time.to_iso8601(message.originating_time)

      raise Error.new(
              :schema_mismatch,
              "a message of #{inspect(info.name)} does not match #{inspect(type)}",
              why: "at #{time} it is #{inspect(message.data, limit: 5, printable_limit: 50)}",
              fix: "read the stream without a type; it was recorded as #{info.type_name}"
            )
    end
  end

  @doc "Checks whether the stream can be read as `type`."
  @spec check_readable(StreamInfo.t(), Situ.Type.t()) :: :ok | {:error, Error.t()}
  def check_readable(info, type) do
    cond do
      struct_module?(type) and info.fields != nil -> check_fields(info, type)
      Situ.Type.accepts?(type, info.type) -> :ok
      true -> {:error, other_type_error(info, type)}
    end
  end

  defp check_fields(info, module) do
    today = module |> struct() |> Map.from_struct() |> Map.keys() |> Enum.map(&to_string/1)
    gone = info.fields -- today
    required = required_fields(module) -- info.fields

    cond do
      gone != [] ->
        {:error,
         mismatch_error(info, module, "recorded fields no longer exist: #{Enum.join(gone, ", ")}")}

      required != [] ->
        {:error,
         mismatch_error(
           info,
           module,
           "required fields were not recorded: #{Enum.join(required, ", ")}"
         )}

      true ->
        :ok
    end
  end

  # There is no way to list enforced keys, so each field is left out in turn to see whether `__struct__/1` raises.
  defp required_fields(module) do
    fields = module |> struct() |> Map.from_struct() |> Map.keys()
    for key <- fields, not builds_with?(module, List.delete(fields, key)), do: to_string(key)
  end

  defp builds_with?(module, keys) do
    module.__struct__(Enum.map(keys, &{&1, nil}))
    true
  rescue
    ArgumentError -> false
  end

  defp convert_to_struct(module, %{} = data) do
    fields =
      for {key, value} <- :maps.to_list(data),
          name = to_string(key),
          name != "__struct__",
          do: {name, value}

    Enum.reduce(fields, struct(module), fn {name, value}, struct ->
      Map.replace(struct, String.to_existing_atom(name), value)
    end)
  end

  defp convert_to_struct(_module, other), do: other

  defp struct_module?(type) do
    is_atom(type) and Situ.KnownModules.ensure_loaded?(type) and
      function_exported?(type, :__struct__, 0)
  end

  defp other_type_error(info, type) do
    %{
      mismatch_error(info, type, "the stream contains #{info.type_name}")
      | fix: "read it as #{info.type_name}, or without a type"
    }
  end

  defp mismatch_error(info, type, why) do
    Error.new(:schema_mismatch, "stream #{inspect(info.name)} cannot be read as #{inspect(type)}",
      why: why,
      fix: "read it without a type, or give new fields a default and keep the old fields"
    )
  end
end
