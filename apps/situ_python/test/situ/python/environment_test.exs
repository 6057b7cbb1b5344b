defmodule Situ.Python.EnvironmentTest do
  use ExUnit.Case, async: true
  alias Situ.Python.Environment

  @moduletag :tmp_dir

  # Stands for an interpreter: it makes an environment with itself, and its pip copies the list into it.
  @python """
  #!/bin/sh
  case "$1 $2" in
    "-VV ") echo "Python VERSION" ;;
    "-m venv") mkdir -p "$3/bin" && cp "$0" "$3/bin/python" ;;
    "-m pip")
      echo "Collecting packages"
      for last; do :; done
      if grep -q missing "$last"; then echo "Temporary failure in name resolution" >&2; exit 1; fi
      cat "$last" >"$(dirname "$0")/../installed" ;;
  esac
  """

  setup %{tmp_dir: dir} do
    test = self()
    log = &send(test, {:log, &1})

    %{
      config: %{uv: nil, folder: Path.join(dir, "cache"), log: log},
      python: write_python(dir, "3.1")
    }
  end

  defp write_python(dir, version) do
    path = Path.join(dir, "python")
    File.write!(path, String.replace(@python, "VERSION", version))
    File.chmod!(path, 0o755)
    path
  end

  test "is made once for a list and an interpreter", %{
    config: config,
    python: python,
    tmp_dir: dir
  } do
    {:ok, made} = Environment.find_or_create(["a==1", "b"], python, config)
    assert File.read!(Path.expand("../../installed", made)) == "a==1\nb\n"
    assert_received {:log, "making a Python environment in " <> _}
    assert_received {:log, "Collecting packages"}
    assert {:ok, ^made} = Environment.find_or_create(["a==1", "b"], python, config)
    refute_received {:log, _}

    {:ok, other} = Environment.find_or_create(["a==2", "b"], python, config)
    assert other != made
    {:ok, upgraded} = Environment.find_or_create(["a==1", "b"], write_python(dir, "3.2"), config)
    assert upgraded != made
    # Nothing but the three environments remains.
    assert length(File.ls!(config.folder)) == 3
  end

  test "is made from a file", %{config: config, python: python, tmp_dir: dir} do
    path = Path.join(dir, "requirements.txt")
    File.write!(path, "c\n")
    {:ok, made} = Environment.find_or_create(path, python, config)
    assert File.read!(Path.expand("../../installed", made)) == "c\n"
    assert {:ok, ^made} = Environment.find_or_create(["c"], python, config)

    assert {:error, error} = Environment.find_or_create(path <> "x", python, config)
    assert error.code == :no_python_file
  end

  test "that cannot be made leaves nothing, and the error says why", %{
    config: config,
    python: python
  } do
    assert {:error, error} = Environment.find_or_create(["missing"], python, config)
    assert error.code == :python_environment
    assert error.why =~ "Temporary failure in name resolution"
    assert error.fix =~ "connect this machine"
    assert File.ls!(config.folder) == []
    assert {:error, error} = Environment.find_or_create(["a"], "/bin/false", config)
    assert error.code == :no_python
  end

  test "is made by uv if it is installed", %{config: config, python: python, tmp_dir: dir} do
    uv = Path.join(dir, "uv")

    File.write!(uv, """
    #!/bin/sh
    case "$1" in
      venv) mkdir -p "$4/bin" && cp "$3" "$4/bin/python" ;;
      pip) cat "$6" >"$(dirname "$4")/../installed" ;;
    esac
    """)

    File.chmod!(uv, 0o755)
    {:ok, made} = Environment.find_or_create(["d"], python, %{config | uv: uv})
    assert File.read!(Path.expand("../../installed", made)) == "d\n"
  end
end
