defmodule Situ.Python.Results do
  @moduledoc false
  # Converts the results of a worker to actions of the component, and checks every value against the type of its output.
  alias Situ.{Error, Type}
  alias Situ.Python.{Protocol, SharedMemory}

  @typedoc "The result of one message: its actions, or why there are none."
  @type t :: {:ok, [Situ.Component.action()] | :finished} | {:error, Error.t()}

  @doc """
  Converts one result. `outputs` are the names and types. Also returns the slots that are free again. The others are
  free when their values have been collected.
  """
  @spec convert_result(Protocol.result(), keyword(Type.t()), SharedMemory.t()) ::
          {t(), [non_neg_integer()]}
  def convert_result({:raised, text, fix}, _outputs, _memory),
    do: {{:error, exception_error(text, fix)}, []}

  def convert_result(:finished, _outputs, _memory), do: {{:ok, :finished}, []}

  def convert_result({:ok, emissions}, outputs, memory) do
    {read, free} = emissions |> Enum.map(&read_emission(&1, memory)) |> Enum.unzip()
    {Error.map_ok(read, &convert_emission(&1, outputs)), Enum.concat(free)}
  end

  @doc "Returns the bytes of the only emission of a reply, or nil if it has none."
  @spec read_reply(Protocol.result(), SharedMemory.t()) ::
          {:ok, binary() | nil} | {:error, Error.t()}
  def read_reply({:raised, text, fix}, _memory), do: {:error, exception_error(text, fix)}
  def read_reply({:ok, []}, _memory), do: {:ok, nil}

  def read_reply({:ok, [emission | _]}, memory) do
    case read_emission(emission, memory) do
      # Checkpoints are kept for long, so they must not use the shared memory.
      {{_index, _time, {:ok, bytes}}, _free} -> {:ok, :binary.copy(bytes)}
      {{_index, _time, {:error, why}}, _free} -> {:error, invalid_value(why)}
    end
  end

  defp read_emission({index, time, {:bytes, bytes}}, _memory),
    do: {{index, time, {:ok, bytes}}, []}

  defp read_emission({index, time, {:slot, slot}}, memory) do
    case SharedMemory.read_value(memory, slot) do
      {:shared, bytes} -> {{index, time, {:ok, bytes}}, []}
      {:copied, bytes} -> {{index, time, {:ok, bytes}}, [slot.number]}
      {:error, why} -> {{index, time, {:error, why}}, [slot.number]}
    end
  end

  defp convert_emission({index, time, read}, outputs) do
    with {:ok, {name, type}} <- fetch_output(outputs, index),
         {:ok, bytes} <- read,
         {:ok, value} <- Protocol.decode_value(bytes),
         {:ok, value} <- build_structs(value) do
      if Type.valid_value?(type, value),
        do: {:ok, {name, time, value}},
        else: {:error, wrong_type(name, type, value)}
    else
      {:error, why} -> {:error, invalid_value(to_string(why))}
    end
  end

  defp fetch_output(outputs, index) do
    with :error <- Enum.fetch(outputs, index),
         do: {:error, "output number #{index} does not exist"}
  end

  # Python may leave out the fields of a struct that have defaults. The decoder does not check the others.
  defp build_structs(%module{} = struct) do
    {:ok, struct!(module, Map.from_struct(struct))}
  rescue
    error -> {:error, Exception.message(error)}
  end

  defp build_structs(list) when is_list(list), do: Error.map_ok(list, &build_structs/1)
  defp build_structs(value), do: {:ok, value}

  defp wrong_type(name, type, value) do
    Error.new(
      :wrong_type,
      "the output #{name} got #{inspect(value, limit: 5, printable_limit: 80)}",
      why: "its type is #{Type.to_string(type)}",
      fix: "return such a value, or change the type in out:"
    )
  end

  defp invalid_value(why),
    do: Error.new(:bad_python_value, "Python returned a value that cannot be read", why: why)

  defp exception_error(text, fix) do
    text = if String.valid?(text), do: text, else: inspect(text)
    last = text |> String.split("\n") |> List.last()

    Error.new(:python_failed, last,
      why: text,
      fix: if(fix != "", do: fix),
      meta: %{traceback: text}
    )
  end
end
