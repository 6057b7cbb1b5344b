defmodule Situ.Store.FileLock do
  @moduledoc """
  A lock between processes of the operating system, for files that are edited in turns, such as the file of a dataset
  and the journal of an annotation stream.

      iex> path = Path.join(System.tmp_dir!(), "situ-doc-lock-#{System.pid()}")
      iex> {:ok, lock} = Situ.Store.FileLock.acquire(path)
      iex> {:held, holder} = Situ.Store.FileLock.acquire(path)
      iex> holder.os_pid == System.pid()
      true
      iex> :ok = Situ.Store.FileLock.release(lock)
      iex> File.exists?(path)
      false

  The lock belongs to one Erlang process. It is released when that process ends, or when its term is garbage collected;
  when the whole program dies, the operating system releases it. While it is held, its file says who holds it
  (`t:holder/0`).
  """
  alias Situ.Error
  alias Situ.Store.{Failure, Native}

  @typedoc "The holder of a lock, as it described itself. A key that cannot be read is `nil`."
  @type holder :: %{
          os_pid: String.t() | nil,
          host: String.t() | nil,
          user: String.t() | nil,
          program: String.t() | nil,
          since: String.t() | nil,
          process: String.t() | nil
        }
  @opaque t :: reference()

  # How long to wait for a lock whose holder in this system has just ended.
  @ending_ms 5_000
  @again_ms 10

  @doc """
  Takes the lock for the calling process: `{:ok, lock}`, or `{:held, holder}` when another process keeps it
  for longer than `wait_ms`. `path` is a file for this purpose alone.
  """
  @spec acquire(Path.t(), non_neg_integer()) ::
          {:ok, t()} | {:held, holder()} | {:error, Error.t()}
  def acquire(path, wait_ms \\ 0) when is_binary(path) and is_integer(wait_ms),
    do: acquire_until(path, now() + wait_ms, now() + @ending_ms)

  defp acquire_until(path, last, last_of_ended) do
    with {:held, text} <- Native.file_lock(path, Situ.JSON.encode(describe_self())) do
      holder = parse_holder(text)

      deadline = if ended?(holder), do: max(last, last_of_ended), else: last

      if now() < deadline do
        receive after: (@again_ms -> acquire_until(path, last, last_of_ended))
      else
        {:held, holder}
      end
    else
      {:ok, lock} ->
        true = Native.file_lock_give(lock, self())
        {:ok, lock}

      {:error, reason} ->
        {:error, Failure.error(reason, path)}
    end
  end

  defp now, do: System.monotonic_time(:millisecond)

  @doc "Makes the calling process the holder of the lock, in place of the process that took it."
  @spec own(t()) :: :ok
  def own(lock) do
    true = Native.file_lock_give(lock, self())
    :ok
  end

  @doc "Releases the lock. Does nothing when it was released already."
  @spec release(t()) :: :ok
  def release(lock), do: Native.file_unlock(lock)

  @doc "Describes the holder for a person: `Anna's situ studio (process 4711 on lab3), since 2026-01-31T12:00:00Z`."
  @spec describe(holder()) :: String.t()
  def describe(holder) do
    who = Enum.map_join([holder.user, holder.program], ": ", &(&1 || "unknown"))

    "#{who} (process #{holder.os_pid || "unknown"} on #{holder.host || "an unknown computer"}), " <>
      "since #{holder.since || "an unknown time"}"
  end

  defp describe_self do
    %{
      os_pid: System.pid(),
      host: host(),
      user: System.get_env("USER") || System.get_env("LOGNAME"),
      program: program(),
      since: Situ.Time.to_iso8601(div(Situ.Time.now(), 1_000_000_000) * 1_000_000_000),
      process: self() |> :erlang.pid_to_list() |> List.to_string()
    }
  end

  defp host do
    {:ok, name} = :inet.gethostname()
    List.to_string(name)
  end

  # The first words of the command line only, since options may contain secrets.
  defp program do
    case Enum.take_while(:init.get_plain_arguments(), &word?/1) do
      [] -> "an Elixir program"
      words -> words |> Enum.take(2) |> Enum.join(" ")
    end
  end

  # An argument that is not UTF-8 is a tuple.
  defp word?(text), do: is_list(text) and List.to_string(text) =~ ~r/\A[a-z][\w.\/-]*\z/i

  defp parse_holder(text) do
    found =
      case Situ.JSON.decode(text) do
        {:ok, %{} = found} -> found
        _ -> %{}
      end

    for key <- [:os_pid, :host, :user, :program, :since, :process],
        into: %{},
        do: {key, printable(found[Atom.to_string(key)])}
  end

  # Any user with access to the folder may have written it, and terminals obey control characters.
  defp printable(text) when is_binary(text),
    do: text |> String.replace(~r/[^[:print:]]/u, "?") |> String.slice(0, 80)

  defp printable(_), do: nil

  # A process of this system that has ended: its lock is about to be released.
  defp ended?(%{os_pid: os_pid, host: host, process: process}) do
    os_pid == System.pid() and host == host() and process != nil and not alive?(process)
  end

  defp alive?(text) do
    text |> String.to_charlist() |> :erlang.list_to_pid() |> Process.alive?()
  rescue
    ArgumentError -> true
  end
end
