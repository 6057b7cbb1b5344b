defmodule Situ.Experiment.Provenance do
  @moduledoc false
  # Everything that a run depends on, as JSON: the experiment's file and its commit, versions, models, the machine.
  alias Situ.Experiment.{CodeVersion, Context}

  @doc "Describes the code of an experiment and the machine. `file` is the experiment's file, or `nil`."
  @spec describe_environment(Context.t(), Path.t() | nil) :: map()
  def describe_environment(%Context{} = context, file) do
    %{
      "file" => file && Path.expand(file),
      "file_sha256" => file && hash_content(file),
      "commit" => file && read_commit(Path.dirname(Path.expand(file))),
      "code" => CodeVersion.hash_function(context.code, context.module, :build),
      "models" => CodeVersion.list_models(context.code, context.module, :build),
      "versions" => list_versions(),
      "machine" => describe_machine()
    }
  end

  @doc "Returns the versions of Situ, Elixir and OTP."
  @spec list_versions() :: %{String.t() => String.t()}
  def list_versions do
    %{
      "situ" => to_string(Application.spec(:situ, :vsn) || "unknown"),
      "elixir" => System.version(),
      "otp" => otp_version()
    }
  end

  @doc "Describes this machine: its name, system, processor and number of cores."
  @spec describe_machine() :: %{String.t() => String.t() | pos_integer() | nil}
  def describe_machine do
    %{
      "host" => host_name(),
      "system" => to_string(:erlang.system_info(:system_architecture)),
      "processor" => read_processor(),
      "cores" => System.schedulers_online()
    }
  end

  @doc "Returns the name and the processor of this machine, as results name it."
  @spec name_machine() :: String.t()
  def name_machine do
    case read_processor() do
      nil -> host_name()
      processor -> "#{host_name()} (#{processor})"
    end
  end

  @doc "Returns the names of the parts in which two environments differ, such as `commit` or `versions`."
  @spec list_changes(map(), map()) :: [String.t()]
  def list_changes(before, now) do
    for key <- ~w(code file_sha256 commit models versions machine),
        before[key] != now[key],
        do: key
  end

  defp hash_content(file) do
    case File.read(file) do
      {:ok, text} -> Base.encode16(:crypto.hash(:sha256, text), case: :lower)
      {:error, _} -> nil
    end
  end

  # A folder that is not in a repository, or a machine without git, has no commit.
  defp read_commit(folder) do
    with git when git != nil <- System.find_executable("git"),
         {id, 0} <- System.cmd(git, ["-C", folder, "rev-parse", "HEAD"], stderr_to_stdout: true),
         {status, 0} <-
           System.cmd(git, ["-C", folder, "status", "--porcelain", "--untracked-files=no"],
             stderr_to_stdout: true
           ) do
      %{"id" => String.trim(id), "changed_files" => status != ""}
    else
      _ -> nil
    end
  end

  defp otp_version do
    release = to_string(:erlang.system_info(:otp_release))
    file = Path.join([to_string(:code.root_dir()), "releases", release, "OTP_VERSION"])

    case File.read(file) do
      {:ok, text} -> String.trim(text)
      {:error, _} -> release
    end
  end

  defp host_name do
    {:ok, name} = :inet.gethostname()
    to_string(name)
  end

  defp read_processor do
    with {:ok, text} <- File.read("/proc/cpuinfo"),
         [_, name] <- Regex.run(~r/^model name\s*:\s*(.+)$/m, text) do
      name
    else
      _ -> nil
    end
  end
end
