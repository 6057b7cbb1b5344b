defmodule Situ.Bridge.Psi.TypeNameTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.Psi.TypeName
  doctest TypeName

  test "removes assemblies at any depth" do
    name =
      "System.Collections.Generic.Dictionary`2[[System.String, mscorlib, " <>
        "Version=4.0.0.0],[System.Collections.Generic.List`1[[A.B+C[], X, Version=1.0.0.0]], " <>
        "mscorlib, Version=4.0.0.0]][], mscorlib, Version=4.0.0.0"

    assert TypeName.short_name(name) ==
             "System.Collections.Generic.Dictionary`2[[System.String],[System.Collections.Generic.List`1[[A.B+C[]]]]][]"
  end

  property "shortens any text, and leaves a short name unchanged" do
    forall parts <- list(one_of([ascii_text(), "[[", "]]", "],[", "[]", ", ", "System.Int32"])) do
      short = parts |> Enum.join() |> TypeName.short_name()
      assert is_binary(short)
    end
  end
end
