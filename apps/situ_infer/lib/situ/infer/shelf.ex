defmodule Situ.Infer.Shelf do
  @moduledoc false
  # Models loaded once and lent to every component that names the same file and options. The process only guards
  # against loading twice at the same time; it holds no session lock, so a lost shelf costs a reload and nothing else.
  use GenServer

  @load_timeout 60_000

  def start_link(_), do: GenServer.start_link(__MODULE__, %{}, name: __MODULE__)

  @spec fetch(term(), (() -> {:ok, term()} | {:error, Situ.Error.t()})) ::
          {:ok, term()} | {:error, Situ.Error.t()}
  def fetch(key, load), do: GenServer.call(__MODULE__, {:fetch, key, load}, @load_timeout)

  @impl true
  def init(models), do: {:ok, models}

  @impl true
  def handle_call({:fetch, key, load}, _from, models) do
    with :error <- Map.fetch(models, key),
         {:ok, model} <- load.() do
      {:reply, {:ok, model}, Map.put(models, key, model)}
    else
      {:ok, model} -> {:reply, {:ok, model}, models}
      {:error, _} = error -> {:reply, error, models}
    end
  end
end
