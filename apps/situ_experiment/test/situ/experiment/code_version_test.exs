defmodule Situ.Experiment.CodeVersionTest do
  use ExUnit.Case, async: false
  alias Situ.Experiment.CodeVersion

  # The module is compiled again and again with other code, which the compiler would warn about.
  setup do
    before = Code.compiler_options()[:ignore_module_conflict]
    Code.compiler_options(ignore_module_conflict: true)
    on_exit(fn -> Code.compiler_options(ignore_module_conflict: before) end)
  end

  @source """
  defmodule Situ.Experiment.CodeVersionTest.Own do
    def parameters, do: [a: [1]]
    def build(x), do: helper(x) + 1
    defp helper(x), do: Situ.Time.ms(x)
    def other(x), do: x
  end
  """
  @own Situ.Experiment.CodeVersionTest.Own

  defp hash(source), do: @own |> then(&CodeVersion.hash_function(version(source), &1, :build))
  defp version(source), do: source |> Code.compile_string() |> Map.new() |> CodeVersion.new()

  test "only the functions that are reached count" do
    first = hash(@source)
    assert first == hash(String.replace(@source, "[a: [1]]", "[a: [1, 2]]"))

    assert first ==
             hash(String.replace(@source, "def other(x), do: x", "def other(x), do: {x, x}"))

    assert first == hash("\n\n" <> @source)
    assert first != hash(String.replace(@source, "+ 1", "+ 2"))
    assert first != hash(String.replace(@source, "Situ.Time.ms(x)", "Situ.Time.ms(x + 1)"))
    assert first != hash(String.replace(@source, "Situ.Time.ms(x)", "Situ.Time.us(x)"))
  end

  @tag :tmp_dir
  test "the same is true of a module of an application", %{tmp_dir: folder} do
    Code.prepend_path(folder)
    on_exit(fn -> Code.delete_path(folder) end)

    hash = fn source ->
      [{module, beam}] = Code.compile_string(source)
      File.write!(Path.join(folder, "#{module}.beam"), beam)
      :code.purge(module)
      :code.delete(module)
      CodeVersion.hash_function(CodeVersion.new(), module, :build)
    end

    first = hash.(@source)
    assert first == hash.(String.replace(@source, "[a: [1]]", "[a: [1, 2]]"))
    assert first != hash.(String.replace(@source, "+ 1", "+ 2"))
  end

  test "another module of the same file counts if it is referred to" do
    helper =
      &"defmodule Situ.Experiment.CodeVersionTest.Help do\n  def ms(x), do: x * #{&1}\nend\n"

    own = String.replace(@source, "Situ.Time.ms", "Situ.Experiment.CodeVersionTest.Help.ms")
    assert hash(helper.(1) <> own) == hash(helper.(1) <> own)
    assert hash(helper.(1) <> own) != hash(helper.(2) <> own)
    assert hash(helper.(1) <> @source) == hash(helper.(2) <> @source)
  end

  test "values count with the code of modules among them" do
    code = CodeVersion.new()
    assert CodeVersion.hash_values(code, %{a: 1}) == CodeVersion.hash_values(code, %{a: 1})
    assert CodeVersion.hash_values(code, %{a: 1}) != CodeVersion.hash_values(code, %{a: 2})

    assert CodeVersion.hash_values(code, %{a: Situ.Time}) !=
             CodeVersion.hash_values(code, %{a: Situ.Rect})
  end
end
