defmodule Situ.Cluster.Deployments do
  @moduledoc false
  # The deployments of a cluster, as its log keeps them: one key with all of them, so that nodes which were all lost at
  # once know again what they ran. Each has a run, a random name that is part of the key of its seals: when its log has
  # been deleted and something else is deployed under the same name, no entry of before is believed.
  #
  # A deployment that was forgotten keeps its run as long as its log is there, and goes on where it was when it is
  # deployed again. Its log has a mark, which goes when the log is deleted, also by somebody without the cookie.
  alias Situ.Cluster.{Deployment, Seal, SealedLog}
  alias Situ.Error
  alias Situ.Remote.Log
  alias Situ.Remote.Log.Entry

  @tries 100

  @typedoc "By name; `deployment` is `nil` when it was forgotten."
  @type known :: %{String.t() => %{run: String.t(), deployment: Deployment.t() | nil}}

  @doc "Notes a deployment, and gives it its run; one that is there under its name must be the same."
  @spec put(Log.t(), Deployment.t()) :: {:ok, Deployment.t()} | {:error, Error.t()}
  def put(log, %Deployment{} = deployment) do
    with {:ok, deployment} <- note(log, deployment),
         :ok <- mark(log, deployment),
         do: {:ok, deployment}
  end

  defp note(log, %{name: name} = deployment) do
    update(log, fn known ->
      with {:ok, run} <- run(log, name, known[name]) do
        deployment = %{deployment | run: run}

        case known[name] do
          %{deployment: %Deployment{} = other} when other != deployment -> {:error, taken(name)}
          _ -> {:ok, Map.put(known, name, %{run: run, deployment: deployment}), deployment}
        end
      end
    end)
  end

  # The one that it had, as long as its log is there.
  defp run(_log, _name, nil), do: {:ok, new_run()}

  defp run(log, name, %{run: run}) do
    with {:ok, there?} <- there?(log, name, run),
         do: {:ok, if(there?, do: run, else: new_run())}
  end

  defp mark(log, %{name: name, run: run}) do
    case Log.append(SealedLog.new(log, run), mark(name), 0, %Entry{op: "deployed"}) do
      {:error, error} -> {:error, error}
      _there -> :ok
    end
  end

  defp mark(name), do: {:key, "run.#{name}.deployed"}

  @doc "Whether the log of a run is there: somebody may have deleted it where no node ran."
  @spec there?(Log.t(), String.t(), String.t()) :: {:ok, boolean()} | {:error, Error.t()}
  def there?(log, name, run) do
    with {:ok, mark} <- Log.last(SealedLog.new(log, run), mark(name)), do: {:ok, mark != nil}
  end

  defp new_run, do: Base.encode16(:crypto.strong_rand_bytes(8), case: :lower)

  @doc "It is not run any more; its log stays."
  @spec forget(Log.t(), String.t()) :: :ok | {:error, Error.t()}
  def forget(log, name) do
    changed(log, fn known ->
      if known[name], do: put_in(known[name].deployment, nil), else: known
    end)
  end

  @doc "Its log is gone."
  @spec delete(Log.t(), String.t()) :: :ok | {:error, Error.t()}
  def delete(log, name), do: changed(log, &Map.delete(&1, name))

  @doc "Those that are to run."
  @spec all(Log.t()) :: {:ok, [Deployment.t()]} | {:error, Error.t()}
  def all(log) do
    with {:ok, known, _seq} <- read(sealed(log)),
         do: {:ok, for({_, %{deployment: %Deployment{} = d}} <- Enum.sort(known), do: d)}
  end

  @doc "The error of a second deployment of one name."
  @spec taken(String.t()) :: Error.t()
  def taken(name) do
    Error.new(:duplicate_name, "there is already a deployment #{inspect(name)}",
      fix:
        "give this one another name:, or stop and forget that one (situ cluster stop NAME --forget)"
    )
  end

  defp changed(log, change) do
    with {:ok, :ok} <- update(log, fn known -> {:ok, change.(known), :ok} end), do: :ok
  end

  defp update(log, change, left \\ @tries) do
    log = if match?(%Log{adapter: SealedLog}, log), do: log, else: sealed(log)

    with {:ok, known, seq} <- read(log), {:ok, changed, answer} <- change.(known) do
      if changed == known,
        do: {:ok, answer},
        else: write(log, {changed, seq, answer}, change, left)
    end
  end

  defp write(log, {changed, seq, answer}, change, left) do
    unique = Base.encode16(:crypto.strong_rand_bytes(6), case: :lower)
    entry = %Entry{op: "deployments.#{unique}", data: Seal.encode_term(changed)}

    case Log.append(log, subject(), seq, entry) do
      {:ok, _seq} -> {:ok, answer}
      {:refused, _} when left > 0 -> update(log, change, left - 1)
      {:refused, _} -> {:error, Error.new(:log_away, "the list of deployments is being written")}
      {:error, error} -> {:error, error}
    end
  end

  defp read(log) do
    case Log.last(log, subject()) do
      {:ok, nil} -> {:ok, %{}, 0}
      {:ok, entry} -> with {:ok, known} <- Seal.decode_term(entry), do: {:ok, known, entry.seq}
      {:error, error} -> {:error, error}
    end
  end

  # Two clusters with cookies of their own may share a log.
  defp subject, do: {:key, "deployments." <> Seal.cluster()}
  defp sealed(log), do: SealedLog.new(log, "")
end
