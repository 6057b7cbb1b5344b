defmodule Situ.Store.KeyRecorder do
  @moduledoc false
  # The component of `Situ.Store.write/4` with `keys: true`. It collects the keys of a stream's
  # maps and ignores all other messages. The keys are saved each time their number has doubled and
  # when the stream closes. If the writer was killed, the metadata contains the last saved keys.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [],
    options: [
      shared: [type: :any, required: true, doc: "The `Situ.Store.SharedWriter`."],
      stream: [type: :any, required: true, doc: "The `Situ.Store.Writer.Stream`."],
      metadata: [type: :map, default: %{}, doc: "Further metadata of the stream."]
    ]

  alias Situ.Store.{SharedWriter, Writer}

  @enforce_keys [:shared, :stream, :metadata]
  defstruct [:shared, :stream, :metadata, keys: MapSet.new(), saved_count: 0]

  @impl true
  def init(opts) do
    {:ok,
     %__MODULE__{
       shared: opts[:shared],
       stream: opts[:stream],
       metadata: opts[:metadata]
     }}
  end

  @impl true
  def handle_message(:in, %{data: %{} = map}, _context, %{keys: keys} = state) do
    keys = map |> to_plain_map() |> Map.keys() |> Enum.reduce(keys, &MapSet.put(&2, &1))
    state = %{state | keys: keys}

    {[],
     if(MapSet.size(keys) >= max(2 * state.saved_count, 1), do: save_keys(state), else: state)}
  end

  def handle_message(:in, _message, _context, state), do: {[], state}

  defp to_plain_map(%_{} = struct), do: Map.from_struct(struct)
  defp to_plain_map(map), do: map

  @impl true
  def handle_closed(:in, _time, _context, state), do: {[], save_keys(state)}

  @impl true
  def terminate(_reason, state), do: SharedWriter.remove_user(state.shared)

  @impl true
  def describe(state), do: "records the keys of #{state.stream.name}"

  defp save_keys(%{keys: keys, saved_count: saved_count} = state) do
    if MapSet.size(keys) == saved_count do
      state
    else
      metadata = Map.put(state.metadata, "keys", Enum.sort(keys))

      case Writer.put_metadata(state.stream, metadata) do
        :ok -> %{state | saved_count: MapSet.size(keys)}
        {:error, error} -> raise error
      end
    end
  end
end
