defmodule Situ.CLI.Leftovers do
  @moduledoc false
  # Removes the unfinished output of a command that is stopped half way (Ctrl-C, kill). The VM ends at once then and
  # can't clean up itself, so a small shell waits for its end: it reads from the VM until there is nothing more.
  alias Situ.Store

  # Files of a store's draft only: somebody's notes stay.
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

  @doc "Sees to it that when this program ends nothing unfinished of the store `out` (ROOT/NAME) is left."
  @spec remove_later(Path.t()) :: :ok
  def remove_later(out) do
    {name, root} = Store.Copying.target(out)
    start(Path.join(root, name), "")
  end

  @doc "The same of the file `file`, which is written as FILE.unfinished."
  @spec remove_file_later(Path.t()) :: :ok
  def remove_file_later(file) do
    file = Path.expand(file)
    start(file, file <> ".unfinished")
  end

  defp start(base, file) do
    with shell when shell != nil <- System.find_executable("sh") do
      args = ["-c", @script, "sh", base, System.pid(), file]
      Port.open({:spawn_executable, shell}, [:binary, args: args])
    end

    :ok
  end
end
