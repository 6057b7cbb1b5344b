defmodule Situ.Infer.ModelCache do
  @moduledoc false
  # A cache of models. Each model is loaded once and shared by all processes that name the same file and options. It is
  # loaded in a separate process, so that loads do not block each other. The processes that use a model are monitored,
  # and an unused model is dropped after a while. The cache contains no sessions, so losing it only costs reloading.
  use GenServer

  @keep_ms 60_000
  @bytes 512 * 1_048_576

  defstruct [:keep_ms, :bytes, models: %{}, loads: %{}, uses: 0]

  def start_link(opts) do
    {name, opts} = Keyword.pop(opts, :name, __MODULE__)
    GenServer.start_link(__MODULE__, opts, name: name)
  end

  @doc """
  Returns the model under `key`, or the result of `load`, which runs in another process. `size` is the size of the model
  in bytes.
  """
  @spec fetch(GenServer.server(), term(), non_neg_integer(), (() -> result)) :: result
        when result: {:ok, term()} | {:error, Exception.t()}
  def fetch(cache \\ __MODULE__, key, size, load),
    do: GenServer.call(cache, {:fetch, key, size, load}, :infinity)

  @doc "Returns the keys of the loaded models, the most recently used one first."
  @spec list_keys(GenServer.server()) :: [term()]
  def list_keys(cache \\ __MODULE__), do: GenServer.call(cache, :keys)

  @impl true
  def init(opts) do
    bytes = Application.get_env(:situ_infer, :shared_bytes, @bytes)
    {:ok, struct!(%__MODULE__{keep_ms: @keep_ms, bytes: bytes}, opts)}
  end

  @impl true
  def handle_call(:keys, _from, state) do
    keys =
      state.models |> Enum.sort_by(fn {_, entry} -> -entry.last_use end) |> Enum.map(&elem(&1, 0))

    {:reply, keys, state}
  end

  def handle_call({:fetch, key, size, load}, {pid, _} = from, state) do
    case state do
      %{models: %{^key => entry}} ->
        {:reply, {:ok, entry.model}, put_entry(state, key, add_user(entry, pid))}

      %{loads: %{^key => loading}} ->
        loading = %{loading | waiting: [from | loading.waiting]}
        {:noreply, %{state | loads: Map.put(state.loads, key, loading)}}

      _ ->
        {_pid, ref} = spawn_monitor(fn -> exit({:loaded, run_loader(load)}) end)
        loading = %{ref: ref, size: size, waiting: [from]}
        {:noreply, %{state | loads: Map.put(state.loads, key, loading)}}
    end
  end

  @impl true
  def handle_info({:DOWN, ref, :process, _pid, reason}, state) do
    case Enum.find(state.loads, fn {_, loading} -> loading.ref == ref end) do
      {key, loading} -> {:noreply, finish_loading(state, key, loading, load_result(reason))}
      nil -> {:noreply, remove_user(state, ref)}
    end
  end

  # Drops the model if nobody requested it since its last user ended.
  def handle_info({:unused, key, last_use}, state) do
    case state.models do
      %{^key => %{last_use: ^last_use, users: users}} when users == %{} ->
        {:noreply, %{state | models: Map.delete(state.models, key)}}

      _ ->
        {:noreply, state}
    end
  end

  defp run_loader(load) do
    load.()
  rescue
    error -> {:error, error}
  end

  defp load_result({:loaded, result}), do: result

  defp load_result(reason) do
    {:error, Situ.Error.new(:bad_model, "loading the model failed: #{inspect(reason)}")}
  end

  defp finish_loading(state, key, loading, result) do
    Enum.each(loading.waiting, &GenServer.reply(&1, result))
    state = %{state | loads: Map.delete(state.loads, key)}

    case result do
      {:ok, model} ->
        entry = %{model: model, size: loading.size, users: %{}, last_use: 0}

        entry =
          Enum.reduce(loading.waiting, entry, fn {pid, _}, entry -> add_user(entry, pid) end)

        state |> put_entry(key, entry) |> evict_oldest(key)

      {:error, _} ->
        state
    end
  end

  defp add_user(%{users: users} = entry, pid) do
    if pid in Map.values(users),
      do: entry,
      else: %{entry | users: Map.put(users, Process.monitor(pid), pid)}
  end

  defp put_entry(state, key, entry) do
    uses = state.uses + 1
    %{state | uses: uses, models: Map.put(state.models, key, %{entry | last_use: uses})}
  end

  defp remove_user(state, ref) do
    case Enum.find(state.models, fn {_, entry} -> is_map_key(entry.users, ref) end) do
      {key, entry} ->
        users = Map.delete(entry.users, ref)

        if users == %{},
          do: Process.send_after(self(), {:unused, key, entry.last_use}, state.keep_ms)

        %{state | models: Map.put(state.models, key, %{entry | users: users})}

      nil ->
        state
    end
  end

  # The model just loaded is never evicted, however large it is.
  defp evict_oldest(state, key) do
    total = state.models |> Map.values() |> Enum.map(& &1.size) |> Enum.sum()
    others = Map.delete(state.models, key)

    if total > state.bytes and others != %{} do
      {oldest, entry} = Enum.min_by(others, fn {_, entry} -> entry.last_use end)
      Enum.each(Map.keys(entry.users), &Process.demonitor(&1, [:flush]))
      evict_oldest(%{state | models: Map.delete(state.models, oldest)}, key)
    else
      state
    end
  end
end
