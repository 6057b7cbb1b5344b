defmodule Situ.Store.FileLock do
  @moduledoc false
  # A lock between operating system processes, for files that several programs edit, such as a
  # dataset file or the journal of an annotation stream.
  #
  # The lock belongs to one Erlang process. It is released when that process ends or its lock term
  # is garbage collected. If the whole program dies, the operating system releases it. While the
  # lock is held, its file describes the holder (`t:holder/0`).
  alias Situ.Error
  alias Situ.Store.{NativeErrors, Native}

  @typedoc "The holder of a lock, as recorded in the lock's file. Unreadable keys are `nil`."
  @type holder :: %{
          os_pid: String.t() | nil,
          host: String.t() | nil,
          user: String.t() | nil,
          program: String.t() | nil,
          since: String.t() | nil,
          process: String.t() | nil
        }
  @opaque t :: reference()

  # Time to wait for a lock whose holder in this system has just ended.
  @ending_ms 5_000
  @again_ms 10

  @doc """
  Acquires the lock for the calling process: `{:ok, lock}`, or `{:held, holder}` if another process still holds it after
  `wait_ms`. `path` must be a file that is used only for this lock.

      iex> path = Path.join(System.tmp_dir!(), "situ-doc-lock-#{System.pid()}")
      iex> {:ok, lock} = Situ.Store.FileLock.acquire(path)
      iex> {:held, holder} = Situ.Store.FileLock.acquire(path)
      iex> holder.os_pid == System.pid()
      true
      iex> :ok = Situ.Store.FileLock.release(lock)
      iex> File.exists?(path)
      false
  """
  @spec acquire(Path.t(), non_neg_integer()) ::
          {:ok, t()} | {:held, holder()} | {:error, Error.t()}
  def acquire(path, wait_ms \\ 0) when is_binary(path) and is_integer(wait_ms),
    do: acquire_until(path, monotonic_ms() + wait_ms, monotonic_ms() + @ending_ms)

  defp acquire_until(path, last, last_of_ended) do
    with {:held, text} <- Native.file_lock(path, Situ.JSON.encode(describe_self())) do
      holder = parse_holder(text)

      deadline = if holder_ended?(holder), do: max(last, last_of_ended), else: last

      if monotonic_ms() < deadline do
        receive after: (@again_ms -> acquire_until(path, last, last_of_ended))
      else
        {:held, holder}
      end
    else
      {:ok, lock} ->
        true = Native.file_lock_give(lock, self())
        {:ok, lock}

      {:error, reason} ->
        {:error, NativeErrors.to_error(reason, path)}
    end
  end

  defp monotonic_ms, do: System.monotonic_time(:millisecond)

  @doc "Makes the calling process the holder of the lock, replacing the process that acquired it."
  @spec take_ownership(t()) :: :ok
  def take_ownership(lock) do
    true = Native.file_lock_give(lock, self())
    :ok
  end

  @doc "Releases the lock. Does nothing if it was already released."
  @spec release(t()) :: :ok
  def release(lock), do: Native.file_unlock(lock)

  @doc "Describes the holder for users: `Anna's situ studio (process 4711 on lab3), since 2026-01-31T12:00:00Z`."
  @spec describe_holder(holder()) :: String.t()
  def describe_holder(holder) do
    who = Enum.map_join([holder.user, holder.program], ": ", &(&1 || "unknown"))

    "#{who} (process #{holder.os_pid || "unknown"} on #{holder.host || "an unknown computer"}), " <>
      "since #{holder.since || "an unknown time"}"
  end

  @doc "Describes the calling process as a holder: its user, program and computer, and the time now."
  @spec describe_self() :: holder()
  def describe_self do
    %{
      os_pid: System.pid(),
      host: host_name(),
      user: System.get_env("USER") || System.get_env("LOGNAME") || account_name(),
      program: program_name(),
      since: Situ.Time.to_iso8601(div(Situ.Time.now(), 1_000_000_000) * 1_000_000_000),
      process: self() |> :erlang.pid_to_list() |> List.to_string()
    }
  end

  # Services may run without these variables.
  defp account_name do
    with {:ok, %{uid: uid}} <- File.stat("/proc/self"),
         {:ok, accounts} <- File.read("/etc/passwd"),
         [_, name] <- Regex.run(~r/^([^:\n]+):[^:\n]*:#{uid}:/m, accounts) do
      name
    else
      _ -> nil
    end
  end

  defp host_name do
    {:ok, name} = :inet.gethostname()
    List.to_string(name)
  end

  # Records only the first words of the command line, since options may contain secrets.
  defp program_name do
    case Enum.take_while(:init.get_plain_arguments(), &plain_word?/1) do
      [] -> "an Elixir program"
      words -> words |> Enum.take(2) |> Enum.join(" ")
    end
  end

  # `:init` returns arguments that are not UTF-8 as tuples.
  defp plain_word?(text), do: is_list(text) and List.to_string(text) =~ ~r/\A[a-z][\w.\/-]*\z/i

  defp parse_holder(text) do
    found =
      case Situ.JSON.decode(text) do
        {:ok, %{} = found} -> found
        _ -> %{}
      end

    for key <- [:os_pid, :host, :user, :program, :since, :process],
        into: %{},
        do: {key, printable_text(found[Atom.to_string(key)])}
  end

  # Any user with access to the folder may have written the file, and terminals interpret control characters.
  defp printable_text(text) when is_binary(text),
    do: text |> String.replace(~r/[^[:print:]]/u, "?") |> String.slice(0, 80)

  defp printable_text(_), do: nil

  # The holder was a process of this system that has ended, so its lock is about to be released.
  defp holder_ended?(%{os_pid: os_pid, host: host, process: process}) do
    os_pid == System.pid() and host == host_name() and process != nil and
      not process_alive?(process)
  end

  defp process_alive?(text) do
    text |> String.to_charlist() |> :erlang.list_to_pid() |> Process.alive?()
  rescue
    ArgumentError -> true
  end
end
