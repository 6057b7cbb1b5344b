defmodule Situ.CLI.UnfinishedOutput do
  @moduledoc false
  # Removes the unfinished output of a command that is stopped early (Ctrl-C, kill). The VM then exits immediately and
  # cannot clean up, so a small shell script waits for its end by reading from a pipe until the VM closes it.
  alias Situ.Store

  # Only files of a store's draft are deleted, so that a user's notes are kept.
  @script """
  trap "" INT TERM HUP QUIT
  while read -r _; do :; done
  for draft in "$1.$2"-*.unfinished; do
    if [ -d "$draft" ] && [ ! -L "$draft" ]; then
      rm -f -- "$draft"/index.situ* "$draft"/data-*.situ "$draft"/large-*.situ "$draft"/lock
      rmdir -- "$draft" 2>/dev/null
    fi
  done
  rm -f -- "$1.$2"-*.unfinished.lock
  if [ -n "$3" ]; then rm -f -- "$3"; fi
  """

  @doc "Removes unfinished drafts of the store `out` (ROOT/NAME) when this program exits."
  @spec remove_store_at_exit(Path.t()) :: :ok
  def remove_store_at_exit(out) do
    {name, root} = Store.Copying.resolve_target(out)
    start_shell(Path.join(root, name), "")
  end

  @doc "Removes the temporary file FILE.unfinished of `file`, with an extension, when this program exits."
  @spec remove_file_at_exit(Path.t(), String.t()) :: :ok
  def remove_file_at_exit(file, extension \\ "") do
    file = Path.expand(file)
    start_shell(file, file <> ".unfinished" <> extension)
  end

  defp start_shell(base, file) do
    with shell when shell != nil <- System.find_executable("sh") do
      args = ["-c", @script, "sh", base, System.pid(), file]
      Port.open({:spawn_executable, shell}, [:binary, args: args])
    end

    :ok
  end
end
