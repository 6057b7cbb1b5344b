defmodule Situ.Component.Snapshot do
  @moduledoc false
  # The state of a component as plain data that a process on another machine can restore; see
  # `c:Situ.Component.snapshot/1`.
  #
  # Without that callback, the state itself is the snapshot. Functions in it (mostly options of operators) are
  # removed, because they are code, not data. The process that restores the snapshot has started with the same
  # options, so it has the same functions at the same positions and inserts them again.
  alias Situ.Error

  @hole :"$situ_fun"

  @type t :: {:own, term()} | {:plain, term()}

  @doc "Takes the snapshot of `core`, the state of a component at `path`."
  @spec take_snapshot(module(), term(), String.t()) :: {:ok, t()} | {:error, Error.t()}
  def take_snapshot(module, core, path) do
    if function_exported?(module, :snapshot, 1) do
      with {:ok, own} <- check_snapshot(module.snapshot(core), path), do: {:ok, {:own, own}}
    else
      with {:ok, plain} <- to_plain_data(core, path), do: {:ok, {:plain, plain}}
    end
  rescue
    error -> {:error, bad_snapshot_error(path, "snapshot", Exception.message(error))}
  end

  defp check_snapshot({:ok, own}, _path), do: {:ok, own}
  defp check_snapshot({:error, %Error{} = error}, _path), do: {:error, error}

  defp check_snapshot(other, path),
    do: {:error, bad_snapshot_error(path, "snapshot", "it returned #{inspect_briefly(other)}")}

  @doc "Returns a state of plain data with each function replaced by a placeholder."
  @spec to_plain_data(term(), String.t()) :: {:ok, term()} | {:error, Error.t()}
  def to_plain_data(term, path) do
    {:ok, strip_functions(term)}
  catch
    {:situ_not_data, what} ->
      {:error,
       Error.new(:no_snapshot, "cannot take a snapshot of #{path}: its state holds #{what}",
         why: "processes, ports and references are not valid in another process or machine",
         fix: "define snapshot/1 and restore/2 in the component",
         meta: %{component: path}
       )}
  end

  @doc "Maps each value of `states` with `fun`, which takes its key, too, and may return an error."
  @spec map_states(map(), (term(), term() -> {:ok, term()} | {:error, Error.t()})) ::
          {:ok, map()} | {:error, Error.t()}
  def map_states(states, fun) do
    Enum.reduce_while(states, {:ok, %{}}, fn {key, state}, {:ok, done} ->
      case fun.(key, state) do
        {:ok, result} -> {:cont, {:ok, Map.put(done, key, result)}}
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
  end

  @doc "Restores the snapshot into `fresh`, the state of a component that has just started."
  @spec restore_state(module(), t(), term(), String.t()) :: {:ok, term()} | {:error, Error.t()}
  def restore_state(_module, {:plain, plain}, fresh, path), do: fill_functions(plain, fresh, path)

  def restore_state(module, {:own, own}, fresh, path) do
    case module.restore(own, fresh) do
      {:ok, core} ->
        {:ok, core}

      {:error, %Error{} = error} ->
        {:error, error}

      other ->
        {:error, bad_snapshot_error(path, "restore", "it returned #{inspect_briefly(other)}")}
    end
  rescue
    error -> {:error, bad_snapshot_error(path, "restore", Exception.message(error))}
  end

  @doc "Replaces the placeholders in `plain` with the functions at the same positions in `fresh`."
  @spec fill_functions(term(), term(), String.t()) :: {:ok, term()} | {:error, Error.t()}
  def fill_functions(plain, fresh, path) do
    {:ok, patch_functions(plain, fresh)}
  catch
    :situ_no_function ->
      {:error,
       Error.new(:no_restore, "#{path} cannot be restored: its state contains functions",
         why:
           "a checkpoint contains no functions, and the component's initial state has none at that position",
         fix: "define snapshot/1 and restore/2 in the component",
         meta: %{component: path}
       )}
  end

  defp strip_functions(fun) when is_function(fun) do
    if :erlang.fun_info(fun, :type) == {:type, :external}, do: fun, else: @hole
  end

  defp strip_functions([head | tail]), do: [strip_functions(head) | strip_functions(tail)]

  defp strip_functions(tuple) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> strip_functions() |> to_tuple()

  defp strip_functions(map) when is_map(map),
    do: :maps.from_list(strip_functions(:maps.to_list(map)))

  defp strip_functions(pid) when is_pid(pid), do: throw({:situ_not_data, "a process"})
  defp strip_functions(port) when is_port(port), do: throw({:situ_not_data, "a port"})
  defp strip_functions(ref) when is_reference(ref), do: throw({:situ_not_data, "a reference"})
  defp strip_functions(data), do: data

  defp to_tuple(list), do: List.to_tuple(list)

  defp patch_functions(@hole, fun) when is_function(fun), do: fun
  defp patch_functions(@hole, _other), do: throw(:situ_no_function)

  defp patch_functions([head | tail], [h | t]),
    do: [patch_functions(head, h) | patch_functions(tail, t)]

  defp patch_functions([head | tail], _other),
    do: [patch_functions(head, nil) | patch_functions(tail, nil)]

  defp patch_functions(tuple, fresh) when is_tuple(tuple) and is_tuple(fresh),
    do: tuple |> Tuple.to_list() |> patch_functions(Tuple.to_list(fresh)) |> to_tuple()

  defp patch_functions(tuple, _fresh) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> patch_functions(nil) |> to_tuple()

  defp patch_functions(map, fresh) when is_map(map) do
    fresh = if is_map(fresh), do: fresh, else: %{}
    :maps.map(fn key, value -> patch_functions(value, Map.get(fresh, key)) end, map)
  end

  defp patch_functions(data, _fresh), do: data

  defp bad_snapshot_error(path, callback, why) do
    Error.new(:bad_snapshot, "#{path}: #{callback} failed: #{why}",
      fix: "return {:ok, data} from snapshot/1, {:ok, state} from restore/2, or {:error, error}",
      meta: %{component: path}
    )
  end

  defp inspect_briefly(term), do: inspect(term, limit: 8, printable_limit: 80)
end
