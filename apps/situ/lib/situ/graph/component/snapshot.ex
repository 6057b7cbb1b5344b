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
  @spec take(module(), term(), String.t()) :: {:ok, t()} | {:error, Error.t()}
  def take(module, core, path) do
    if function_exported?(module, :snapshot, 1) do
      with {:ok, own} <- own(module.snapshot(core), path), do: {:ok, {:own, own}}
    else
      with {:ok, plain} <- plain(core, path), do: {:ok, {:plain, plain}}
    end
  rescue
    error -> {:error, failed(path, "snapshot", Exception.message(error))}
  end

  defp own({:ok, own}, _path), do: {:ok, own}
  defp own({:error, %Error{} = error}, _path), do: {:error, error}
  defp own(other, path), do: {:error, failed(path, "snapshot", "it returned #{brief(other)}")}

  @doc "Returns a state of plain data with each function replaced by a placeholder."
  @spec plain(term(), String.t()) :: {:ok, term()} | {:error, Error.t()}
  def plain(term, path) do
    {:ok, strip(term)}
  catch
    {:situ_not_data, what} ->
      {:error,
       Error.new(:no_snapshot, "cannot take a snapshot of #{path}: its state holds #{what}",
         why: "processes, ports and references are not valid in another process or machine",
         fix: "define snapshot/1 and restore/2 in the component",
         meta: %{component: path}
       )}
  end

  @doc "Restores the snapshot into `fresh`, the state of a component that has just started."
  @spec put(module(), t(), term(), String.t()) :: {:ok, term()} | {:error, Error.t()}
  def put(_module, {:plain, plain}, fresh, path), do: fill(plain, fresh, path)

  def put(module, {:own, own}, fresh, path) do
    case module.restore(own, fresh) do
      {:ok, core} -> {:ok, core}
      {:error, %Error{} = error} -> {:error, error}
      other -> {:error, failed(path, "restore", "it returned #{brief(other)}")}
    end
  rescue
    error -> {:error, failed(path, "restore", Exception.message(error))}
  end

  @doc "Replaces the placeholders in `plain` with the functions at the same positions in `fresh`."
  @spec fill(term(), term(), String.t()) :: {:ok, term()} | {:error, Error.t()}
  def fill(plain, fresh, path) do
    {:ok, patch(plain, fresh)}
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

  defp strip(fun) when is_function(fun) do
    if :erlang.fun_info(fun, :type) == {:type, :external}, do: fun, else: @hole
  end

  defp strip([head | tail]), do: [strip(head) | strip(tail)]
  defp strip(tuple) when is_tuple(tuple), do: tuple |> Tuple.to_list() |> strip() |> to_tuple()
  defp strip(map) when is_map(map), do: :maps.from_list(strip(:maps.to_list(map)))
  defp strip(pid) when is_pid(pid), do: throw({:situ_not_data, "a process"})
  defp strip(port) when is_port(port), do: throw({:situ_not_data, "a port"})
  defp strip(ref) when is_reference(ref), do: throw({:situ_not_data, "a reference"})
  defp strip(data), do: data

  defp to_tuple(list), do: List.to_tuple(list)

  defp patch(@hole, fun) when is_function(fun), do: fun
  defp patch(@hole, _other), do: throw(:situ_no_function)
  defp patch([head | tail], [h | t]), do: [patch(head, h) | patch(tail, t)]
  defp patch([head | tail], _other), do: [patch(head, nil) | patch(tail, nil)]

  defp patch(tuple, fresh) when is_tuple(tuple) and is_tuple(fresh),
    do: tuple |> Tuple.to_list() |> patch(Tuple.to_list(fresh)) |> to_tuple()

  defp patch(tuple, _fresh) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> patch(nil) |> to_tuple()

  defp patch(map, fresh) when is_map(map) do
    fresh = if is_map(fresh), do: fresh, else: %{}
    :maps.map(fn key, value -> patch(value, Map.get(fresh, key)) end, map)
  end

  defp patch(data, _fresh), do: data

  defp failed(path, callback, why) do
    Error.new(:bad_snapshot, "#{path}: #{callback} failed: #{why}",
      fix: "return {:ok, data} from snapshot/1, {:ok, state} from restore/2, or {:error, error}",
      meta: %{component: path}
    )
  end

  defp brief(term), do: inspect(term, limit: 8, printable_limit: 80)
end
