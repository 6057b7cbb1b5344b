defmodule Situ.CLI.Secret do
  @moduledoc false
  # Tokens that verbs need. Every user of the machine can read the command line of a process, but not a private file
  # or its environment.
  alias Situ.CLI.{Option, Output}
  alias Situ.Error
  alias Situ.Remote.Access

  @doc "Returns the option that names the token's file; `doc` says what the token is for."
  @spec option(String.t()) :: Option.t()
  def option(doc \\ "the file that holds the token (its first line); SITU_TOKEN holds one, too"),
    do: Option.new(:token_file, :path, doc)

  @doc """
  Returns the token that was given by `--token-file`, by the older `--token` (with a warning), or by SITU_TOKEN, or
  `nil`. Errors: `:no_token`, `:usage`.
  """
  @spec token(keyword()) :: {:ok, String.t() | nil} | {:error, Error.t()}
  def token(opts) do
    case {opts[:token_file], opts[:token]} do
      {nil, nil} ->
        {:ok, from_environment()}

      {file, nil} ->
        warn_of_readers(file)
        Access.first_line(file)

      {nil, token} ->
        Output.warn(
          "situ: every user of this machine can read --token in the list of processes\n" <>
            "  Fix: write it into a file with the mode 0600 and give --token-file FILE, or set SITU_TOKEN"
        )

        {:ok, token}

      _ ->
        {:error, Error.new(:usage, "--token and --token-file are both given", fix: "give one")}
    end
  end

  @doc "Warns when an address has a password in it."
  @spec warn_of_password(String.t(), String.t()) :: :ok
  def warn_of_password(address, fix) do
    if URI.parse(address).userinfo != nil do
      Output.warn(
        "situ: every user of this machine can read the password in the address, in the list of processes\n" <>
          "  Fix: #{fix}"
      )
    end

    :ok
  end

  defp from_environment do
    case System.get_env("SITU_TOKEN") do
      "" -> nil
      token -> token
    end
  end

  # Access by the group may be intended, access by everybody is not.
  defp warn_of_readers(file) do
    with {:ok, %{mode: mode}} when Bitwise.band(mode, 0o004) != 0 <- File.stat(file) do
      Output.warn(
        "situ: every user of this machine can read #{file}\n  Fix: chmod 600 #{Output.name(file)}"
      )
    end
  end
end
